"""Arguments of the functions of the library: what is wrong is refused in one line before anything
is computed."""

from __future__ import annotations

from numbers import Integral, Real


def require_count(name: str, value: object) -> int:
    """Return a whole number, 1 at least, as an int; floats such as 1e5 are taken.

    Args:
        name: of the argument, for the message.
        value: what was given.

    Raises:
        ValueError: one line, for anything else.
    """
    count = find_whole(value)
    if count is None or count < 1:
        raise ValueError(f"{name} = {value}: is no whole number from 1 up; give one, such as 256")
    return count


def find_whole(value: object) -> int | None:
    """Return a whole number as an int, None for anything else."""
    if isinstance(value, bool) or not isinstance(value, Real):
        return None
    if isinstance(value, Integral):
        return int(value)
    number = float(value)
    return int(number) if number.is_integer() else None


def describe_type(value: object) -> str:
    """Return the type of an argument with its article, such as "a Scenario"."""
    name = type(value).__name__
    article = "an" if name[0].lower() in "aeiou" else "a"
    return f"{article} {name}"
