"""From nested tables of plain values to a validated `Scenario`; every refusal is one line with
source, key, value and cure."""

import difflib
import math
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Literal, NoReturn, get_args, get_origin, get_type_hints

import msgspec

from jaxtube.scenario import rules
from jaxtube.scenario.refusal import literal, refusal
from jaxtube.scenario.tree import Scenario

WORDS = {
    "int": "a whole number",
    "float": "a number",
    "str": "text",
    "bool": "true or false",
    "array": "a list",
    "null": "left out",
}
"""What msgspec calls its types, in words for those who write TOML."""


def validate(tables: Mapping[str, Any], find_source: Callable[[str], str]) -> Scenario:
    """Return the scenario of tables of plain values.

    Args:
        tables: section name -> table, as TOML gives them.
        find_source: where the value of a dotted key came from, for messages.

    Raises:
        ScenarioError: one line.
    """

    def raise_refusal(key: str, value: Any, problem: str, cure: str) -> NoReturn:
        raise refusal(find_source(key), key, value, problem, cure) from None

    for key, value in _walk(tables):
        if isinstance(value, float) and not math.isfinite(value):
            raise_refusal(key, value, "is not finite", "give a finite number")
        if not _is_unicode(key) or not _is_unicode(value):
            raise_refusal(key, value, "is not UTF-8 text", "write or rename it in UTF-8")
    try:
        scenario = msgspec.convert(tables, Scenario)
    except msgspec.ValidationError as error:
        raise_refusal(*_explain(str(error), tables))

    def refuse(key: str, problem: str, cure: str) -> NoReturn:
        section, name = key.split(".")
        raise_refusal(key, getattr(getattr(scenario, section), name), problem, cure)

    rules.check_rules(scenario, refuse)
    return scenario


def find_default(key: str) -> Any:
    """Return the default of a dotted key, None for one that does not exist."""
    section, _, name = key.split("[")[0].partition(".")
    return getattr(getattr(Scenario(), section, None), name, None)


def find_keys(name: str) -> list[str]:
    """Return the dotted keys that end in a name."""
    tables = {section: getattr(Scenario(), section) for section in Scenario.__struct_fields__}
    return [f"{key}.{name}" for key, table in tables.items() if name in table.__struct_fields__]


def known_keys() -> list[str]:
    """Return all dotted keys."""
    tables = {section: getattr(Scenario(), section) for section in Scenario.__struct_fields__}
    return [f"{key}.{name}" for key, table in tables.items() for name in table.__struct_fields__]


def find_choices(key: str) -> tuple[str, ...]:
    """Return the values that a dotted key with choices may take, as TOML has them without quotes;
    none for a key whose values are endless."""
    section, name = key.split(".")
    kind = get_type_hints(type(getattr(Scenario(), section)))[name]
    if kind is bool:
        return ("true", "false")
    return get_args(kind) if get_origin(kind) is Literal else ()


def _walk(node: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Yield (dotted key, value) of everything in nested tables and lists that is neither."""
    if isinstance(node, Mapping):
        for name, child in node.items():
            yield from _walk(child, f"{key}.{name}" if key else name)
    elif isinstance(node, list | tuple):
        for index, child in enumerate(node):
            yield from _walk(child, f"{key}[{index}]")
    else:
        yield key, node


def _is_unicode(value: Any) -> bool:
    """Return False for text with bytes that were no UTF-8, which Python keeps as surrogates."""
    return not isinstance(value, str) or not re.search(r"[\ud800-\udfff]", value)


def _explain(message: str, tables: Mapping[str, Any]) -> tuple[str, Any, str, str]:
    """Turn msgspec's "Expected `int`, got `str` - at `$.controller.horizon`" into key, value,
    problem and cure."""
    text, _, place = message.partition(" - at `$")
    key = place.strip("`.")
    value: Any = tables
    for name in re.findall(r"\w+", key):
        value = value[int(name)] if isinstance(value, list | tuple) else value[name]
    unknown = re.fullmatch(r"Object contains unknown field `(.*)`", text, re.DOTALL)
    if unknown:
        name = unknown[1]
        full_key = f"{key}.{name}" if key else name
        problem = "unknown key" if key else "unknown section"
        return full_key, value[name], problem, _suggest(full_key)
    if "." not in key:
        return key, value, "must be a table", f"write [{key}] and its keys below it"
    if text.startswith("Invalid enum value"):
        return key, value, "unknown choice", f"choose one of {', '.join(find_choices(key))}"
    default = find_default(key)
    cure = f"the default is {literal(default)}"
    if key in ("robot.wheel_lag_s", "robot.command_delay_s"):
        cure = f"give [least, greatest]; {cure}"
    return key, value, _describe_requirement(text), cure


def _describe_requirement(text: str) -> str:
    """Put msgspec's "Expected `int` >= 1" into words."""
    expected = re.match(r"Expected `([^`]*)`([^,]*)", text)
    if not expected:
        return "is out of range"
    kinds, bound = expected.groups()
    words = [WORDS[kind] for kind in kinds.split(" | ")]
    return f"must be {' or '.join(words)}{bound}"


def _suggest(key: str) -> str:
    """Return a cure for a key that does not exist: the one probably meant."""
    sections = Scenario.__struct_fields__
    known = []
    for section in sections:
        names = getattr(Scenario(), section).__struct_fields__
        known.extend(f"{section}.{name}" for name in names)
    name = key.split(".")[-1]
    same_name = [other for other in known if other.split(".")[1] == name]
    close = same_name or difflib.get_close_matches(key, [*sections, *known], n=1, cutoff=0.6)
    return f"did you mean {close[0]}?" if close else f"the sections are {', '.join(sections)}"
