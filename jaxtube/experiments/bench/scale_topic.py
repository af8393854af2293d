"""`bench scale`: its tables, its figure and its metrics.

Source: new.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from jaxtube.experiments.bench import horizons, lap_counts, scale_figure, shares, threads
from jaxtube.experiments.bench.cases import is_asked_for
from jaxtube.experiments.bench.horizons import fit_exponents
from jaxtube.experiments.bench.pinned import run_pinned
from jaxtube.experiments.bench.rounds import spread, write_number
from jaxtube.experiments.bench.scale_tables import (
    CORES,
    Results,
    has_dask,
    over_one,
    write_horizons,
    write_laps,
    write_shares,
    write_threads,
    write_tiles,
)
from jaxtube.experiments.bench.topic import Headline, Told, Topic, describe, say_verdict
from jaxtube.experiments.options import BenchOptions
from jaxtube.experiments.run.folder import RunFolder
from jaxtube.scenario.reading import load
from jaxtube.scenario.tree import Scenario

HORIZONS = (5, 10, 20, 40)
OF_HORIZONS = "certified"
OF_SHARES = "tuned"
"""Scenarios whose horizon grows, and whose plans have active rows, unless another is asked for."""


def run(scenario: Scenario, options: BenchOptions, folder: RunFolder) -> Told:
    """Measure, print the tables, draw the figure."""
    results = measure(scenario, options)
    told = headlines(results)
    folder.report(f"{say_verdict(told)}\n")
    folder.report(f"{write_laps(results)}\n")
    folder.report(f"{write_tiles(results.laps)}\n")
    folder.report(f"{write_threads(results.threads)}\n")
    folder.report(f"{write_shares(results)}\n")
    folder.report(write_horizons(results))
    figure = scale_figure.scale(results.laps, results.shares, results.horizons)
    folder.save_figure(figure, "scale")
    return Told(metrics(results), told)


TOPIC = Topic(
    "laps of a Monte Carlo from a thousand to a million, on one core and on two; programs of "
    "longer horizons: about eight minutes",
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
