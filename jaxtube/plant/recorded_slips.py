"""Slips taken from a log: rows of a file, drawn in blocks.

    time_s, right_slip, left_slip, sideslip

in rows, slips as shares of the wheel speeds, sideslip by forward speed, left positive. A row holds
until the next one, for the median time between rows. Longer times are gaps of the log; they are
closed, and the last row is followed by the first. Every `BLOCK_S` seconds of a lap a block of rows
begins at a row that is drawn anew, all alike, and goes on as it was recorded: slips that follow
each other stay together, as do both wheels and the sideslip.

Slips become deviations xi by the intervals of the scenario (`jaxtube.plant.slip_bounds`). A log may
hold slips that the scenario does not allow; they are replayed as they are, |xi| > 1, and counted.

Source: the circular block bootstrap of Politis and Romano, A circular block-resampling procedure
for stationary data, 1992.
"""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Key

from jaxtube.plant.protocol import Memory
from jaxtube.plant.slip_bounds import slip_bounds
from jaxtube.plant.slip_processes import Iid
from jaxtube.recordings.table import Cells, open_table, read_cells, read_numbers
from jaxtube.scenario.refusal import refusal
from jaxtube.scenario.tree import Scenario

COLUMNS = ("time_s", "right_slip", "left_slip", "sideslip")

BLOCK_S = 5.0
"""Length of a block, s: about as long as a command lasts."""

FEWEST_ROWS = 2

ROUNDING = 1e-9
"""Deviation beyond 1, and time beyond that of a row relative to it, that is rounding."""


@dataclass(frozen=True, eq=False)
class RecordedSlips:
    """The slips of a file.

    Attributes:
        path: the file.
        period: that a row holds, s.
        values: (right slip, left slip, sideslip).
    """

    path: str
    period: float
    values: Float[np.ndarray, "n 3"]


@dataclass(frozen=True)
class Recorded:
    """Replay blocks of recorded deviations.

    Attributes:
        rows: deviations (right, left, sideslip) in float64, row by row: bytes, which are hashed
            once, however many there are.
        offsets: rows from the start of a block, for each of its steps.
        columns: that the two numbers drawn are taken from.
    """

    rows: bytes
    offsets: tuple[int, ...]
    columns: tuple[int, int] = (0, 1)

    opposed = False

    @property
    def measured(self) -> Iid:
        """The law of measured slips about the true ones, of which a log knows nothing."""
        return Iid()

    @property
    def sideslip(self) -> Recorded:
        """The law of the sideslip: that of the same rows, where the key is the same."""
        return Recorded(self.rows, self.offsets, (2, 2))

    @property
    def deviations(self) -> Float[np.ndarray, "n 3"]:
        """Deviations (right, left, sideslip)."""
        return np.frombuffer(self.rows).reshape(-1, 3)

    @property
    def is_outside(self) -> Bool[np.ndarray, "n"]:
        """Which rows hold what the scenario does not allow."""
        return np.any(np.abs(self.deviations) > 1.0 + ROUNDING, axis=1)

    def initial(self, key: Key[Array, ""], dtype) -> Memory:
        """Return no memory: blocks depend on key and step alone."""
        return ()

    def draw(self, key, step, memory, situation):
        """Return the deviations of the row in force."""
        block, place = jnp.divmod(jnp.asarray(step), len(self.offsets))
        rows = jnp.asarray(self.deviations[:, list(self.columns)], situation.errors.dtype)
        start = jax.random.randint(jax.random.fold_in(key, block), (), 0, len(rows))
        row = (start + jnp.asarray(self.offsets)[place]) % len(rows)
        return rows[row], memory


def make_recorded(scenario: Scenario) -> Recorded:
    """Return the process "recorded" of a scenario.

    Raises:
        ScenarioError: in one line, for a file that cannot be used, or slips that differ where the
            scenario leaves them no room at all.
    """
    recorded = read_recording(scenario)
    bounds = slip_bounds(scenario.slip)
    middle = np.append(bounds.middle, 0.0)
    half = np.append(bounds.half_width, scenario.slip.sideslip)
    off = recorded.values - middle
    is_rigid = half == 0.0
    _refuse_rigid(recorded, np.any(off != 0.0, axis=0) & is_rigid)
    deviations = off / np.where(is_rigid, 1.0, half)
    dt = scenario.controller.dt_s
    steps = max(1, round(BLOCK_S / dt))
    offsets = np.floor(np.arange(steps) * dt / recorded.period + ROUNDING).astype(int)
    return Recorded(deviations.tobytes(), tuple(offsets.tolist()))


def _refuse_rigid(recorded: RecordedSlips, rigid: Bool[np.ndarray, "3"]) -> None:
    """Refuse slips that differ from the only ones that a scenario allows."""
    keys = ("slip.right", "slip.left", "slip.sideslip")
    for place in np.flatnonzero(rigid):
        problem = (
            f"holds {COLUMNS[1 + place]} that differs from the only one that {keys[place]} allows"
        )
        given = "a greatest one" if keys[place] == "slip.sideslip" else "an interval"
        raise _refuse(recorded.path, problem, f"give {keys[place]} {given}")


def read_recording(scenario: Scenario) -> RecordedSlips:
    """Return the recorded slips that a scenario names.

    Raises:
        ScenarioError: as `read_slips`, and where it names none.
    """
    if not scenario.slip.recording:
        cure = "name a file that `replay` writes"
        raise _refuse("", 'is empty, and slip.process is "recorded"', cure)
    return read_slips(scenario.slip.recording)


def read_slips(path: str | Path) -> RecordedSlips:
    """Read recorded slips.

    Raises:
        ScenarioError: in one line, for what is no table of slips.
    """
    try:
        cells = _read_columns(path)
        places = [cells.table.names.index(name) for name in COLUMNS]
        table = np.column_stack([read_numbers(cells, place) for place in places])
    except ValueError as error:
        problem = str(error).removeprefix(f"{path}: ").partition("; ")[0]
        raise _refuse(path, problem, "name a file that `replay` writes") from None
    time = table[:, 0]
    values = table[:, 1:]
    _check_rows(path, cells, time, values)
    return RecordedSlips(str(path), float(np.median(np.diff(time))), values)


def _read_columns(path: str | Path) -> Cells:
    table = open_table(path)
    missing = [name for name in COLUMNS if name not in table.names]
    if missing:
        raise ValueError(f"has no column {missing[0]}, only {table.list_names()}")
    return read_cells(table, [table.names.index(name) for name in COLUMNS])


def _check_rows(
    path: str | Path, cells: Cells, time: Float[np.ndarray, "n"], values: Float[np.ndarray, "n 3"]
) -> None:
    """Refuse rows that are no recording."""
    if len(time) < FEWEST_ROWS:
        raise _refuse(path, "has a single row", "record more")
    empty = np.flatnonzero(np.isnan(np.column_stack([time, values])).any(axis=1))
    if empty.size:
        raise _refuse(path, f"lacks a number in line {cells.lines[empty[0]]}", "drop the row")
    back = np.flatnonzero(np.diff(time) <= 0.0)
    if back.size:
        line = cells.lines[back[0] + 1]
        raise _refuse(path, f"goes back in time in line {line}", "sort the rows by time_s")
    spinning = np.flatnonzero(np.any(np.abs(values) >= 1.0, axis=1))
    if spinning.size:
        line = cells.lines[spinning[0]]
        raise _refuse(path, f"holds a slip of 1 or more in line {line}", "drop the row")


def _refuse(path: str | Path, problem: str, cure: str) -> ValueError:
    return refusal("scenario", "slip.recording", str(path), problem, cure)


def write_slips(time: Float[np.ndarray, "n"], values: Float[np.ndarray, "n 3"]) -> str:
    """Return recorded slips as the text of a file that `read_slips` reads."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for instant, row in zip(time, values, strict=True):
        writer.writerow([f"{instant:.4f}", *(f"{value:.6f}" for value in row)])
    return text.getvalue()


def describe_recording(scenario: Scenario) -> str:
    """Return what laps with the process "recorded" meet, in words."""
    recorded = read_recording(scenario)
    outside = int(make_recorded(scenario).is_outside.sum())
    rows = len(recorded.values)
    beyond = "none of them outside what the scenario allows"
    if outside:
        beyond = f"{outside} of them OUTSIDE what the scenario allows"
    return (
        f"slips of {Path(recorded.path).name}, blocks of {BLOCK_S:g} s drawn from its {rows} rows "
        f"of {recorded.period:.3g} s, {beyond}"
    )
