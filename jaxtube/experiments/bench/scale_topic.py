"""`bench scale`: its tables, its figure and its metrics.

Source: new.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxtube.experiments.bench import horizons, lap_counts, scale_figure, shares, threads
from jaxtube.experiments.bench.cases import is_asked_for
from jaxtube.experiments.bench.horizons import HorizonResult, fit_exponents
from jaxtube.experiments.bench.lap_counts import LapsResult
from jaxtube.experiments.bench.pinned import run_pinned
from jaxtube.experiments.bench.rounds import Spread, spread, write_number
from jaxtube.experiments.bench.shares import SharesResult
from jaxtube.experiments.bench.threads import ThreadsResult
from jaxtube.experiments.bench.topic import Headline, Told, Topic, describe
from jaxtube.experiments.options import BenchOptions
from jaxtube.experiments.run.folder import RunFolder
from jaxtube.experiments.run.table import Column, format_table, left, wrap
from jaxtube.scenario.reading import load
from jaxtube.scenario.tree import Scenario

HORIZONS = (5, 10, 20, 40)
OF_HORIZONS = "certified"
OF_SHARES = "tuned"
"""Scenarios whose horizon grows, and whose plans have active rows, unless another is asked for."""
CORES = 2


class Results(NamedTuple):
    """What was measured, with the names of the scenarios: of laps, shares and horizons."""

    name: str
    laps: LapsResult
    threads: ThreadsResult
    of_shares: str
    shares: SharesResult
    of_horizons: str
    horizons: list[HorizonResult]


def run(scenario: Scenario, options: BenchOptions, folder: RunFolder) -> Told:
    """Measure, print the tables, draw the figure."""
    results = measure(scenario, options)
    folder.report(f"{write_laps(results)}\n")
    folder.report(f"{write_tiles(results.laps)}\n")
    folder.report(f"{write_threads(results.threads)}\n")
    folder.report(f"{write_shares(results)}\n")
    folder.report(write_horizons(results))
    figure = scale_figure.scale(results.laps, results.shares, results.horizons)
    folder.save_figure(figure, "scale")
    return Told(metrics(results), headlines(results))


TOPIC = Topic(
    "laps of a Monte Carlo from a thousand to a million, on one core and on two; programs of "
    "longer horizons: about four minutes",
    run,
)


def measure(scenario: Scenario, options: BenchOptions) -> Results:
    """Measure everything."""
    seed = options.seed
    quick = options.quick
    laps = run_pinned(
        1, lap_counts.measure, scenario, seed, lap_counts.QUICK if quick else lap_counts.FULL
    )
    kinds = ("devices", "workers") if has_dask() else ("devices",)
    extent = threads.QUICK if quick else threads.FULL
    on_cores = run_pinned(CORES, threads.measure, scenario, seed, extent, kinds)
    asked = is_asked_for(options)
    of_shares = scenario if asked else load(OF_SHARES, ())
    size_of_shares = shares.QUICK if quick else shares.FULL
    plans = run_pinned(1, shares.measure, of_shares, seed, size_of_shares)
    name = options.scenario if asked else OF_HORIZONS
    longer = [
        load(name, (*options.overrides, f"controller.horizon={N}"))
        for N in (HORIZONS[:2] if quick else HORIZONS)
    ]
    size = horizons.QUICK if quick else horizons.FULL
    programs = run_pinned(1, horizons.measure, longer, seed, size)
    names = (options.label,) * 2 if asked else (OF_SHARES, OF_HORIZONS)
    return Results(options.label, laps, on_cores, names[0], plans, names[1], programs)


def has_dask() -> bool:
    """Return whether workers can be started."""
    return importlib.util.find_spec("distributed") is not None


def write_laps(results: Results) -> str:
    """Return laps a second by laps as a table."""
    laps = results.laps
    most = laps.checked[max(laps.checked)]
    rows = [
        [f"{count:,}", str(spread(speeds)), write_number(spread(speeds).median / np.median(most))]
        for count, speeds in laps.checked.items()
    ]
    rows += [
        [f"{count:,}", f"left out: {seconds:,.0f} s", ""]
        for count, seconds in laps.left_out.items()
    ]
    columns = [Column("laps"), Column("laps a second"), Column("over that of\nthe most laps")]
    text = (
        f"{results.name}: a Monte Carlo of so many laps, every period checked, on one thread; "
        "medians, in brackets quartiles of rounds."
    )
    return "\n".join([*wrap(text), "", format_table(columns, rows)])


def write_tiles(laps: LapsResult) -> str:
    """Return laps a second by laps side by side as a table."""
    rows = [[f"{tile:,}", str(spread(speeds))] for tile, speeds in laps.bare.items()]
    columns = [Column("side by side"), Column("laps a second, without checks")]
    return format_table(columns, rows)


def write_threads(found: ThreadsResult) -> str:
    """Return laps a second on one core and on two as a table."""
    rows = []
    for (kind, count), seconds in found.seconds.items():
        speed = spread(found.laps / seconds)
        rows.append([f"{kind}: {count}", str(speed), str(over_one(found, kind, count))])
    columns = [left("checked laps"), Column("laps a second"), Column("over one")]
    text = f"When this began, {found.load:.1f} processes wanted the machine's cores."
    if found.cores < CORES:
        text += f" It has {found.cores} core: two of a kind share it."
    if not has_dask():
        text += " Workers: Dask is not installed: pip install 'jaxtube[cluster]'."
    return "\n".join([format_table(columns, rows), *wrap(text)])


def over_one(found: ThreadsResult, kind: str, count: int) -> Spread:
    """Return how many times as fast so many of a kind are as one, round by round."""
    return spread(found.seconds[kind, 1] / found.seconds[kind, count])


def write_shares(results: Results) -> str:
    """Return what a plan costs by the share of a batch that has active rows, as a table."""
    found = results.shares
    columns = [Column("active", "%"), *(Column(name, "us") for name in found.microseconds)]
    rows = [
        [
            f"{100 * share:g}",
            *(write_number(spread(times[at]).median) for times in found.microseconds.values()),
        ]
        for at, share in enumerate(found.shares)
    ]
    text = (
        f"{results.of_shares}: a plan in batches of {found.batch} of which so many have an active "
        f"row; largest residual {found.largest_residual:.0e}."
    )
    return "\n".join([*wrap(text), "", format_table(columns, rows)])


def write_horizons(results: Results) -> str:
    """Return what a program costs by horizon as a table."""
    exponents = fit_exponents(results.horizons)
    names = list(exponents)
    columns = [
        Column("N"),
        Column("n"),
        Column("m"),
        Column("active\nrows"),
        *(Column(name.replace(", ", ",\n"), "us") for name in names),
        Column("largest\nresidual"),
    ]
    rows = [_write_horizon(result, names) for result in results.horizons]
    fitted = [write_number(exponents[name]) for name in names]
    rows.append(["exponent", "", "", "", *fitted, ""])
    text = (
        f"{results.of_horizons}: programs with active rows from the edge of the feasible set of "
        "its first window, each solved cold on one thread; the exponents are those of N, by least "
        "squares. Residual: the batched solver's."
    )
    return "\n".join([*wrap(text), "", format_table(columns, rows)])


def _write_horizon(result: HorizonResult, names: list[str]) -> list[str]:
    if not result.solvers:
        return [f"{result.horizon}", "no tube fits", *[""] * (len(names) + 3)]
    times = {each.name: write_number(spread(each.microseconds).median) for each in result.solvers}
    return [
        f"{result.horizon}",
        f"{result.n}",
        f"{result.m}",
        write_number(result.active),
        *(times.get(name, "-") for name in names),
        f"{result.solvers[0].accuracy.largest:.0e}",
    ]


def metrics(results: Results) -> dict:
    """Return what was measured."""
    exponents = fit_exponents(results.horizons)
    return {
        "checked_laps_per_s_by_laps": _describe_all(results.laps.checked),
        "bare_laps_per_s_by_laps_side_by_side": _describe_all(results.laps.bare),
        "load_of_the_machine": results.threads.load,
        "checked_laps_per_s_by_cores": {
            f"{kind}_{count}": describe(spread(results.threads.laps / seconds))
            for (kind, count), seconds in results.threads.seconds.items()
        },
        "us_a_plan_by_percent_active": {
            name: {
                f"{100 * share:g}": describe(spread(each))
                for share, each in zip(results.shares.shares, times, strict=True)
            }
            for name, times in results.shares.microseconds.items()
        },
        "us_a_program_by_horizon": {
            f"{result.horizon}": {
                "n": result.n,
                "m": result.m,
                "mean_active_rows": result.active,
                **{each.name: describe(spread(each.microseconds)) for each in result.solvers},
            }
            for result in results.horizons
        },
        "exponent_of_horizon": exponents,
    }


def _describe_all(values: Mapping[int, Float[np.ndarray, " rounds"]]) -> dict:
    return {f"{key}": describe(spread(each)) for key, each in values.items()}


def headlines(results: Results) -> list[Headline]:
    """Return what the table of all topics shows."""
    checked = {count: np.median(each) for count, each in results.laps.checked.items()}
    least = min(checked)
    most = max(checked)
    lines = [
        Headline(
            f"scale, {results.name}: {least:,} laps beside {most:,}",
            f"{checked[least]:,.0f} laps/s",
            f"{checked[most]:,.0f} laps/s",
            write_number(checked[least] / checked[most]),
        )
    ]
    found = results.threads
    for kind, count in found.seconds:
        if count > 1:
            ours = f"{found.laps / np.median(found.seconds[kind, count]):,.0f} laps/s"
            one = f"{found.laps / np.median(found.seconds[kind, 1]):,.0f} laps/s"
            ratio = str(over_one(found, kind, count))
            lines.append(Headline(f"scale, {count} {kind} beside one", ours, one, ratio))
    exponents = fit_exponents(results.horizons)
    for name in list(results.shares.microseconds)[1:]:
        lines += [_compare_shares(results, name, at) for at in (0, -1)]
    laws = [f"{name}: N^{exponent:.2f}" for name, exponent in exponents.items()]
    lines += [Headline("scale, time against the horizon", laws[0], law, "") for law in laws[1:]]
    return lines


def _compare_shares(results: Results, name: str, at: int) -> Headline:
    """Return the line of one share of active rows beside one peer."""
    found = results.shares
    ours = next(iter(found.microseconds.values()))[at]
    peer = found.microseconds[name][at]
    return Headline(
        what=f"scale, {results.of_shares}: a plan, {100 * found.shares[at]:g} % active",
        ours=f"{write_number(spread(ours).median)} us",
        peer=f"{name}: {write_number(spread(peer).median)} us",
        ratio=str(spread(peer / ours)),
        residual=f"{found.largest_residual:.0e}",
    )
