"""The words that may come next on a command line: commands, options and their values, scenarios,
and keys of a scenario with their choices."""

import dataclasses
import shlex
from collections.abc import Iterator
from typing import Any, Literal, get_args, get_origin

from tyro.conf import Positional, Suppress

from jaxtube.experiments.options import COMMANDS, DEFAULT_COMMAND, Options, flag

SCENARIOS = ("scenario", "against", "names")
"""Options whose value is a scenario."""


def complete(line: str) -> list[str]:
    """Return the words that may end a line, which begins with the program's name: those that go on
    from what is typed of the last word."""
    *before, typed = _split(line)
    return [word for word in _list_words(before[1:], typed) if word.startswith(typed)]


def _split(line: str) -> list[str]:
    """Return the words of a line, the last one being that which is typed."""
    try:
        words = shlex.split(line)
    except ValueError:  # inside quotes
        words = line.split()
    return [*words, ""] if not line or line[-1].isspace() else words


def _list_words(before: list[str], typed: str) -> list[str]:
    """Return what may stand after the words before."""
    name = before[0] if before and before[0] in COMMANDS else DEFAULT_COMMAND
    fields = list(_list_fields(COMMANDS[name]))
    named = {flag(field.name): field for field in fields if not _has(field, Positional)}
    asked = named.get(before[-1]) if before else None
    if asked is not None and asked.type is not bool:
        return _list_values(asked)
    if typed.startswith("-"):
        return [*named, "--help"]
    words = [] if before else list(COMMANDS)
    for field in fields:
        if _has(field, Positional):
            words += _list_values(field)
    takes_scenario = any(field.name == "scenario" for field in fields)
    return words + (list_keys(typed) if takes_scenario else [])


def _list_fields(kind: type[Options]) -> Iterator[dataclasses.Field]:
    """Yield the options of a command that its help shows."""
    return (field for field in dataclasses.fields(kind) if not _has(field, Suppress))


def _has(field: dataclasses.Field, marker: Any) -> bool:
    return marker in getattr(field.type, "__metadata__", ())


def _list_values(field: dataclasses.Field) -> list[str]:
    """Return the values of an option: its choices or scenarios; none where they are endless."""
    if field.name in SCENARIOS:
        from jaxtube.scenario.reading import names

        return names()
    kind = get_args(field.type)[0] if hasattr(field.type, "__metadata__") else field.type
    return list(get_args(kind)) if get_origin(kind) is Literal else []


def list_keys(typed: str) -> list[str]:
    """Return what an override may go on with: a section, then a key, then its choices."""
    from jaxtube.scenario.validation import find_choices, known_keys

    keys = known_keys()
    key, equals, _ = typed.partition("=")
    if equals:
        choices = find_choices(key) if key in keys else ()
        return [f"{key}={choice}" for choice in choices]
    if "." in typed:
        return [f"{key}=" for key in keys]
    return list(dict.fromkeys(f"{key.split('.')[0]}." for key in keys))
