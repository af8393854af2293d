"""Which column holds what: as the user says, else by the usual names.

Source: new.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from jaxtube.recordings.hints import Hints
from jaxtube.recordings.spelling import assume_unit, ends_with, is_named, normalise, split_unit
from jaxtube.recordings.table import Table, shorten
from jaxtube.recordings.usual_names import (
    STAMP_PAIRS,
    TIME,
    UNIT_SUFFIXES,
    Role,
)


class Column(NamedTuple):
    """A column, or some that are taken together, and what it holds.

    Attributes:
        role: what it holds.
        places: in the table, from 0 on; two of a stamp in seconds and nanoseconds, any number of
            wheels that are averaged.
        name: as the file has it, for messages.
        unit: of its numbers, "" where they have none.
        is_assumed: neither the user nor the name told the unit.
    """

    role: Role
    places: tuple[int, ...]
    name: str
    unit: str
    is_assumed: bool

    def describe(self) -> str:
        """Return what was taken for what, such as "time = stamp in ns"."""
        unit = f" in {self.unit}" if self.unit else ""
        assumed = " (assumed)" if self.is_assumed and self.unit else ""
        return f"{self.role.name} = {shorten(self.name)}{unit}{assumed}"


Columns = dict[str, Column]
"""Columns by the names of their roles."""


def find_columns(table: Table, roles: Iterable[Role], hints: Hints) -> Columns:
    """Return the columns that hold what is sought, those left out that the table has not.

    Args:
        table: to search.
        roles: what is sought.
        hints: columns and units that the user names.

    Raises:
        ValueError: in one line, for a column that the user names and the table has not, a unit
            that is unknown, and names that stand twice.
    """
    names = [normalise(name) for name in table.names]
    found = {}
    for role in roles:
        chosen = hints.columns.get(role.name)
        column = _choose(table, role, chosen) if chosen else _guess(table, role, names)
        if column is not None:
            found[role.name] = _set_unit(column, hints.find_unit(role.name))
    return found


def require_columns(table: Table, columns: Mapping[str, Column], roles: Sequence[Role]) -> None:
    """Refuse a table that lacks columns.

    Raises:
        ValueError: in one line with the columns there are and the option that names one.
    """
    lacking = [role for role in roles if role.name not in columns]
    if not lacking:
        return
    option = ",".join(f"{role.name}=NAME" for role in lacking)
    words = join_words([role.words for role in lacking])
    if table.has_names:
        raise ValueError(
            f"{table.path}: no column is known to hold {words}, among {table.list_names()}; "
            f"name {'it' if len(lacking) == 1 else 'them'}: --columns {option}"
        )
    wheels = [role.name for role in lacking if role.kind == "wheel"]
    units = f" and --units {','.join(f'{name}=m/s' for name in wheels)}" if wheels else ""
    raise ValueError(
        f"{table.path}: has no header that tells what its {len(table.names)} columns hold "
        f"(the first row: {table.first_row}); say which has {words}: "
        f"--columns {option.replace('NAME', 'NUMBER')}{units}"
    )


def join_words(words: Sequence[str]) -> str:
    """Return "a, b and c"."""
    return " and ".join(filter(None, [", ".join(words[:-1]), words[-1]]))


def find_wheel_unit(table: Table, columns: Columns) -> str:
    """Return the unit of both wheels.

    Raises:
        ValueError: in one line, for wheels of two units, or of none where columns have no names.
    """
    right = columns["right"]
    left = columns["left"]
    if right.unit != left.unit:
        raise ValueError(
            f"{table.path}: the wheels are in two units, {left.describe()} and "
            f"{right.describe()}; name two columns of one unit: --columns left=NAME,right=NAME"
        )
    if left.is_assumed and not table.has_names:
        raise ValueError(
            f"{table.path}: columns {left.name} and {right.name} have no names that tell the unit "
            "of the wheels; give it, such as --units left=m/s,right=m/s"
        )
    return left.unit


def _choose(table: Table, role: Role, chosen: str) -> Column:
    """Return the column that the user names, by name or number, or the sum of such."""
    place = _look_up(table, chosen)
    parts = [chosen] if place is not None else chosen.split("+")
    option = f"--columns {role.name}={shorten(chosen)}"
    places = tuple(find_place(table, option, part) for part in parts)
    name = "+".join(table.names[each] for each in places)
    unit = split_unit(normalise(table.names[places[0]]), role)[1]
    if role is TIME and len(places) == 2:
        return Column(role, places, name, "s", False)
    return Column(role, places, name, unit or assume_unit(role), not unit)


def find_place(table: Table, option: str, name: str) -> int:
    """Return the place of a column that the user names, in whatever spelling, or by its number.

    Args:
        table: to search.
        option: by which it is named, for messages.
        name: of the column.

    Raises:
        ValueError: in one line, where there is none or several have the name.
    """
    place = _look_up(table, name)
    if place is None:
        raise ValueError(
            f"{table.path}: {option}: there is no column {shorten(name)}; name one of "
            f"{table.list_names()}"
        )
    return place


def _look_up(table: Table, chosen: str) -> int | None:
    """Return the place of the column of a name or number, None where there is none."""
    wanted = chosen.strip()
    spellings = (
        lambda name: name,
        lambda name: name.lower(),
        normalise,
    )
    for spell in spellings:
        places = [place for place, name in enumerate(table.names) if spell(name) == spell(wanted)]
        if len(places) > 1:
            raise ValueError(
                f"{table.path}: {len(places)} columns have the name {shorten(wanted)}; give the "
                f"number of one, such as {places[0] + 1}"
            )
        if places:
            return places[0]
    is_number = wanted.isdecimal() and 1 <= int(wanted) <= len(table.names)
    return int(wanted) - 1 if is_number else None


def _guess(table: Table, role: Role, names: Sequence[str]) -> Column | None:
    """Return the column with the likeliest of the usual names, None where none has one."""
    if not table.has_names:
        return None
    pair = _find_stamp_pair(names) if role is TIME else None
    if pair is not None:
        name = "+".join(table.names[place] for place in pair)
        return Column(role, pair, name, "s", False)
    # Of longer names those that say most come first: `pose_orientation_z` before `orientation_z`.
    endings = sorted(role.names, key=len, reverse=True)
    for matches, usual_names in ((is_named, role.names), (ends_with, endings)):
        for usual in usual_names:
            places = [place for place, name in enumerate(names) if matches(name, usual, role)]
            if places:
                return _take_only(table, role, usual, _prefer_first_unit(names, places, role))
    return None


def _find_stamp_pair(names: Sequence[str]) -> tuple[int, int] | None:
    """Return the places of the seconds and nanoseconds of stamps, None where there are none."""
    for seconds, nanoseconds in STAMP_PAIRS:
        first = [place for place, name in enumerate(names) if f"_{name}".endswith(f"_{seconds}")]
        rest = [place for place, name in enumerate(names) if f"_{name}".endswith(f"_{nanoseconds}")]
        if len(first) == 1 and len(rest) == 1:
            return first[0], rest[0]
    return None


def _prefer_first_unit(names: Sequence[str], places: Sequence[int], role: Role) -> list[int]:
    """Return those of some columns whose unit comes first, as metres do before ticks."""
    units = ["", *UNIT_SUFFIXES[role.kind]]
    ranks = [units.index(split_unit(names[place], role)[1]) for place in places]
    return [place for place, rank in zip(places, ranks, strict=True) if rank == min(ranks)]


def _take_only(table: Table, role: Role, usual: str, places: Sequence[int]) -> Column:
    """Return the one column that has a usual name.

    Raises:
        ValueError: in one line, where several have it.
    """
    if len(places) > 1:
        several = ", ".join(shorten(table.names[place]) for place in places)
        raise ValueError(
            f"{table.path}: {len(places)} columns may hold {role.words}: {several}; name one: "
            f"--columns {role.name}={shorten(table.names[places[0]])} (or {places[0] + 1})"
        )
    place = places[0]
    unit = split_unit(normalise(table.names[place]), role)[1] or role.units.get(usual, "")
    return Column(role, (place,), table.names[place], unit or assume_unit(role), not unit)


def _set_unit(column: Column, unit: str | None) -> Column:
    """Return a column in the unit that the user says, if any.

    Raises:
        ValueError: in one line, for a unit that is not known.
    """
    if unit is None:
        return column
    known = UNIT_SUFFIXES[column.role.kind]
    if unit not in known:
        cure = f"give one of {', '.join(known)}" if known else "leave it out, it has no unit"
        raise ValueError(f"--units {column.role.name}={unit}: is no unit of it; {cure}")
    return column._replace(unit=unit, is_assumed=False)
