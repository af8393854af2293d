"""What `bench gpu` has measured so far: printed at once, and saved at once as metrics.

Source: new.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import jax

from jaxtube.experiments.bench.agreement import Agreement, Amount
from jaxtube.experiments.bench.sweep import Case, Row
from jaxtube.experiments.run.folder import RunFolder
from jaxtube.experiments.run.table import Column, format_table, left
from jaxtube.reporting.page import Page

BILLION = 1e9
"""Laps that the time is told of."""
NOT_MEASURED = (
    "No GPU here: nothing of a GPU was measured. The programs below are those of a GPU, on this "
    "processor and small: that they work, not how fast they are."
)
HEADINGS = (
    f"{'scenario':<12}{'floats':>8}{'laps at once':>14}{'compiled':>10}{'bare':>12}"
    f"{'checked':>12}{'laps':>12}{'busy':>7}{'memory':>10}\n"
    f"{'':<12}{'':>8}{'':>14}{'s':>10}{'steps/s':>12}{'steps/s':>12}{'per s':>12}{'%':>7}"
    f"{'MB':>10}"
)


class Record:
    """Rows, agreements and words of one run."""

    def __init__(self, folder: RunFolder, device: Any, has_gpu: bool):
        """Begin, and say on what.

        Args:
            folder: of the run.
            device: that laps are run on.
            has_gpu: whether that is a GPU.
        """
        self.begin = time.perf_counter()
        self.folder = folder
        self.device = device
        self.has_gpu = has_gpu
        self.rows: list[Row] = []
        self.agreements: dict[Case, Agreement] = {}
        self.say(f"{device.device_kind}, jax {jax.__version__}")
        if not has_gpu:
            self.say(NOT_MEASURED)

    def say(self, text: str) -> None:
        """Print and save a part of the report at once; nothing where it is empty."""
        if text:
            self.folder.report(text)
            sys.stdout.flush()

    def begin_rows(self) -> None:
        """Say how long designs and programs took, and head the rows."""
        self.say(f"compiled after {time.perf_counter() - self.begin:.0f} s\n\n{HEADINGS}")

    def add_row(self, row: Row) -> None:
        """Print and save what was measured of a program."""
        self.rows.append(row)
        self.say(format_row(row))
        self.save()

    def add_agreement(self, case: Case, amount: Amount, found: Agreement) -> None:
        """Print and save how far laps are from the processor's."""
        self.agreements[case] = found
        self.say(describe_agreement(case, amount, found))
        self.save()

    def save(self) -> None:
        """Write metrics.json anew, whole or not at all."""
        self.folder.save_metrics(self._metrics())

    def end(self) -> None:
        """Print and save the best of each case."""
        self.say(summarise(self.rows, self.has_gpu))
        seconds = time.perf_counter() - self.begin
        self.say(f"{seconds:.0f} s in all; written to {self.folder.path}/")
        self.save()
        cases = len(find_best(self.rows))
        verdict = f"Laps of {cases} cases, measured on {self.device.device_kind}."
        self.folder.save_page(Page(verdict))

    def _metrics(self) -> dict[str, Any]:
        best = find_best(self.rows)
        return {
            "device": self.device.device_kind,
            "measured_on_gpu": self.has_gpu,
            "seconds": time.perf_counter() - self.begin,
            "rows": [row._asdict() for row in self.rows],
            "best": {
                f"{case.scenario}_float{case.bits}": {
                    "laps_at_once": row.laps_at_once,
                    "laps_per_s": row.laps_per_s,
                    "seconds_for_1e9_laps": BILLION / row.laps_per_s,
                }
                for case, row in best.items()
            },
            "against_the_processor": {
                f"{case.scenario}_float{case.bits}": found._asdict()
                for case, found in self.agreements.items()
            },
        }


def format_row(row: Row) -> str:
    """Return a row below `HEADINGS`."""
    busy = "-" if row.utilisation_percent is None else f"{row.utilisation_percent:.0f}"
    bare = "" if row.bare_steps_per_s is None else f"{row.bare_steps_per_s:.3g}"
    memory = row.temporary_mb if row.memory_mb is None else row.memory_mb
    return (
        f"{row.scenario:<12}{row.bits:>8}{row.laps_at_once:>14,}{row.compile_s:>10.1f}"
        f"{bare:>12}{row.checked_steps_per_s:>12.3g}{row.laps_per_s:>12.4g}"
        f"{busy:>7}{memory:>10,.0f}"
    )


def describe_agreement(case: Case, amount: Amount, found: Agreement) -> str:
    """Return how far laps are from the processor's, in words."""
    parts = ", ".join(f"{name} {value:.2g}" for name, value in found.largest.items())
    events = "equal" if not found.events_differ else f"{found.events_differ} differ"
    return (
        f"{case.words}, against the processor: {amount.recorded:,} laps, largest difference: "
        f"{parts}; periods with other diagnostics: {found.other_diagnostics}; counts of events of "
        f"{amount.counted:,} laps: {events}"
    )


def find_best(rows: list[Row]) -> dict[Case, Row]:
    """Return the row of each case with the most checked laps a second."""
    best: dict[Case, Row] = {}
    for row in rows:
        case = Case(row.scenario, row.bits)
        if case not in best or row.laps_per_s > best[case].laps_per_s:
            best[case] = row
    return best


def summarise(rows: list[Row], has_gpu: bool) -> str:
    """Return the best of each case as a table, with the time of a billion laps."""
    columns = [
        left("scenario, floats"),
        Column("best laps at once"),
        Column("laps a second"),
        Column("checked steps/s"),
        Column("10^9 laps"),
    ]
    cells = [
        [
            case.words,
            f"{row.laps_at_once:,}",
            f"{row.laps_per_s:,.0f}",
            f"{row.checked_steps_per_s:.3g}",
            f"{BILLION / row.laps_per_s / 60:,.1f} min" if has_gpu else "not measured",
        ]
        for case, row in find_best(rows).items()
    ]
    note = "10^9 laps: from the speed of the best, all checks made; nobody ran them."
    return f"\n{format_table(columns, cells)}\n{note if has_gpu else NOT_MEASURED}"
