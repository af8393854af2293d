"""The tables of `bench scale`.

Source: new.
"""

from __future__ import annotations

import importlib.util
from typing import NamedTuple

import numpy as np

from jaxtube.experiments.bench.horizons import HorizonResult, fit_exponents
from jaxtube.experiments.bench.lap_counts import LapsResult
from jaxtube.experiments.bench.rounds import Spread, spread, write_number
from jaxtube.experiments.bench.shares import SharesResult
from jaxtube.experiments.bench.threads import ThreadsResult
from jaxtube.experiments.run.table import Column, format_table, left, wrap

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
