"""Times of samples, exact where floating-point numbers are too short for them.

A stamp since 1970 in nanoseconds has 19 digits, a float64 has 16: such stamps are subtracted as
decimals or integers, and only then become floats.

Source: IEEE Std 1003.1, 4.16 (seconds since the epoch); IEEE 754-2019 for the digits of a float.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from decimal import Decimal
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxtube.recordings.columns import Column
from jaxtube.recordings.delimiter import is_number
from jaxtube.recordings.table import Cells, read_numbers, refuse_cell, write_points

DIGITS = {"s": 0, "ms": 3, "us": 6, "ns": 9}
"""Decimal places of each unit in a second."""

LARGEST_SECONDS = 1e11
"""A stamp in seconds beyond it would be later than the year 5138."""

LEAST_STAMPS = (("ns", 1e17), ("us", 1e14), ("ms", 1e11))
"""Least stamp since 1970 that must be in a unit other than seconds."""

LEAST_EPOCH = 1e8
"""A larger number of seconds is a stamp since 1970, of 1973 or later."""

LARGEST_FLOAT = 1e6
"""Up to it, floats keep a time to 1e-10 of its unit."""

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)

DATE = re.compile(r"(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d:\d\d)(\.\d+)?(Z|[+-]\d\d:?\d\d)?")
"""Date, time, fraction of a second and zone, as ISO 8601 has them."""


class Stamps(NamedTuple):
    """Times of samples.

    Attributes:
        first: time of the first sample on the clock of the recording, s.
        since: times since the first sample, s.
    """

    first: Decimal
    since: Float[np.ndarray, "n"]


def read_stamps(cells: Cells, column: Column) -> tuple[Stamps, Column]:
    """Read the times of a table's rows, in the order of the rows.

    Returns:
        The times, and the column in the unit that the size of the stamps tells.

    Raises:
        ValueError: in one line, for a cell that is no finite number.
    """
    if len(column.places) == 2:
        return subtract_first(_read_pairs(cells, column)), column
    place = column.places[0]
    if DATE.fullmatch(cells.columns[place][0].strip()):
        stamps = [_read_date(cells, place, row) for row in range(len(cells.lines))]
        return subtract_first(stamps), column._replace(unit="", is_assumed=False)
    numbers = read_numbers(cells, place)
    missing = np.flatnonzero(np.isnan(numbers))
    if missing.size:
        refuse_cell(cells, place, int(missing[0]))
    largest = float(np.abs(numbers).max())
    unit = find_unit(largest, column)
    is_told = unit != column.unit or largest > LEAST_EPOCH
    column = column._replace(unit=unit, is_assumed=column.is_assumed and not is_told)
    digits = DIGITS[column.unit]
    if largest > LARGEST_FLOAT:
        texts = write_points(cells, place)
        return subtract_first([Decimal(text).scaleb(-digits) for text in texts]), column
    since = (numbers - numbers[0]) / 10**digits
    return Stamps(Decimal(float(numbers[0])).scaleb(-digits), since), column


def find_unit(largest: float, column: Column) -> str:
    """Return the unit of stamps: the one said, unless they are too large to be in it."""
    if largest / 10 ** DIGITS[column.unit] < LARGEST_SECONDS:
        return column.unit
    return next(unit for unit, least in LEAST_STAMPS if largest >= least)


def _read_date(cells: Cells, place: int, row: int) -> Decimal:
    """Return the seconds since 1970 of a date, in UTC where it names no zone."""
    match = DATE.fullmatch(cells.columns[place][row].strip())
    if match is None:
        refuse_cell(cells, place, row, "no date and time")
    day, clock, fraction, zone = match.groups()
    try:
        moment = datetime.fromisoformat(f"{day}T{clock}{zone or '+00:00'}")
    except ValueError:
        refuse_cell(cells, place, row, "no date and time")
    return Decimal((moment - EPOCH) // timedelta(seconds=1)) + Decimal(fraction or 0)


def _read_pairs(cells: Cells, column: Column) -> list[Decimal]:
    """Return stamps of seconds and nanoseconds."""
    seconds = _read_decimals(cells, column.places[0])
    rests = _read_decimals(cells, column.places[1])
    return [second + rest.scaleb(-9) for second, rest in zip(seconds, rests, strict=True)]


def _read_decimals(cells: Cells, place: int) -> list[Decimal]:
    """Return the numbers of a column as decimals."""
    decimals = []
    for row, text in enumerate(write_points(cells, place)):
        number = Decimal(text) if is_number(text) else Decimal("nan")
        if not number.is_finite():
            refuse_cell(cells, place, row)
        decimals.append(number)
    return decimals


def subtract_first(stamps: Sequence[Decimal]) -> Stamps:
    """Return times in s since the first one, each rounded once."""
    first = stamps[0]
    return Stamps(first, np.array([float(stamp - first) for stamp in stamps]))


def count_nanoseconds(stamps: Sequence[int]) -> Stamps:
    """Return times in s since the first of stamps in ns, each rounded once."""
    first = stamps[0]
    since = np.array([(stamp - first) / 10**9 for stamp in stamps])
    return Stamps(Decimal(first).scaleb(-9), since)
