"""From nested tables of plain values to a validated `Scenario`; every refusal is one line with
source, key, value and cure."""

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Literal, NoReturn, get_args, get_origin, get_type_hints

import msgspec

from jaxtube.scenario import rules
from jaxtube.scenario.nearest import ask_if_meant, find_nearest, offer
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
    return [key for key in known_keys() if _ending(key) == name]


def find_near_keys(name: str, keys: Sequence[str] | None = None) -> list[str]:
    """Return those of some keys, of all where None, that end in the names nearest to another
    one."""
    keys = known_keys() if keys is None else keys
    nearest = find_nearest(name, dict.fromkeys(map(_ending, keys)))
    return [key for key in keys if _ending(key) in nearest]


def _ending(key: str) -> str:
    return key.split(".")[1]


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
        value = value[name]
        if not key and isinstance(value, Mapping) and value:
            first = next(iter(value))
            full_key = f"{name}.{first}"
            value = value[first]
        return full_key, value, problem, _suggest(full_key)
    if "." not in key:
        return key, value, "must be a table", f"write [{key}] and its keys below it"
    if text.startswith("Invalid enum value"):
        return key, value, "unknown choice", offer(str(value), find_choices(key))
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
    """Return a cure for a key or section that does not exist: what was probably meant, or else what
    there is."""
    sections = Scenario.__struct_fields__
    section, dot, name = key.partition(".")
    near = [section] if section in sections else find_nearest(section, sections)
    inside = [known for known in known_keys() if known.split(".")[0] in near]
    if dot:
        same = find_keys(name)
        meant = [known for known in same if known in inside] or same
        meant = meant or find_near_keys(name, inside) or find_near_keys(name)
    else:
        meant = find_keys(section) or near or find_near_keys(section)
    if section in sections and not meant:
        return f"the keys of [{section}] are {', '.join(map(_ending, inside))}"
    return ask_if_meant(meant) or f"the sections are {', '.join(sections)}"
