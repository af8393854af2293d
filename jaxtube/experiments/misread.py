"""What is wrong with words that the parser of the command line does not take, and what was probably
meant."""

import dataclasses
import itertools
import re
from collections.abc import Iterator, Sequence

from tyro.conf import Suppress

from jaxtube.experiments.options import COMMANDS, PROGRAM, flag
from jaxtube.scenario.nearest import ask_if_meant, find_nearest, offer
from jaxtube.scenario.reading import names
from jaxtube.scenario.validation import find_keys, find_near_keys, known_keys


def explain(words: Sequence[str], box: str) -> str:
    """Return in one line what is wrong and a cure.

    Args:
        words: the words, the first one naming the command.
        box: what the parser says of them, as it draws it.
    """
    command, *others = words
    if command not in COMMANDS:
        return f"{command}: is no command; {offer(command, COMMANDS)}"
    said = _read(box)
    if said.startswith("Unrecognized"):
        told = list(_explain_unknown(command, others)) or [said]
    else:
        told = [_explain_value(said)]
    return "; ".join([*told, f"see {PROGRAM} {command} --help"])


def _read(box: str) -> str:
    """Return the sentence at the top of the box that the parser draws."""
    lines = [re.sub(r"\x1b\[[0-9;]*m|[|│╭╮╰╯]", "", line).strip() for line in box.splitlines()[1:]]
    groups = itertools.groupby(lines, lambda line: set(line) <= set("-+─"))
    sentences = [" ".join(group) for is_rule, group in groups if not is_rule]
    return sentences[0].rstrip(".") if sentences else "not understood"


def _explain_value(said: str) -> str:
    """Return what is wrong with the value of an option, with the choice that was meant."""
    pattern = r"invalid choice '(.*)' for argument '(.*)'. Expected one of \((.*)\)"
    choice = re.fullmatch(pattern, said)
    if not choice:
        return said
    value, name, listed = choice.groups()
    choices = re.findall(r"'([^']*)'", listed)
    return f"{name} = {value}: unknown choice; {offer(value, choices)}"


def _explain_unknown(command: str, words: Sequence[str]) -> Iterator[str]:
    """Yield what is wrong with each word that a command does not take, as far as it can be told."""
    options = _list_options(command)
    before = ""
    for word, following in itertools.pairwise([*words, ""]):
        name, _, value = word.partition("=")
        value = value or ("" if following.startswith("--") else following)
        if name.startswith("--") and name not in options:
            yield f"{name}: is no option of {command}; {_cure_option(name, value, options)}"
        elif not name.startswith("-") and not before.startswith("--"):
            cure = _cure_word(name, value)
            if cure:
                yield f"{name}: is no word that {command} takes; {cure}"
        before = word


def _list_options(command: str) -> list[str]:
    fields = dataclasses.fields(COMMANDS[command])
    hidden = [field for field in fields if Suppress in getattr(field.type, "__metadata__", ())]
    return [flag(field.name) for field in fields if field not in hidden]


def _cure_option(name: str, value: str, options: Sequence[str]) -> str:
    """Return what was meant by an option that a command does not have: a key of the scenario, an
    option of other commands, or the nearest of its own."""
    ending = name.removeprefix("--").replace("-", "_")
    keys = find_keys(ending)
    if keys:
        return _write(keys, value)
    owners = [command for command in COMMANDS if name in _list_options(command)]
    if owners:
        return f"it is one of {', '.join(owners)}"
    nearest = find_nearest(name, options)
    if nearest:
        return ask_if_meant(nearest)
    return _write(find_near_keys(ending), value) or "leave it out"


def _cure_word(name: str, value: str) -> str:
    """Return what was meant by a word without a name: a scenario, or a key; empty for another."""
    if name in names():
        return f"write --scenario {name}"
    return _write(find_nearest(name, known_keys()), value) if "." in name else ""


def _write(keys: Sequence[str], value: str) -> str:
    """Return the overrides to write instead; empty without any."""
    overrides = " or ".join(f"{key}={value or 'VALUE'}" for key in keys)
    return f"write {overrides}" if overrides else ""
