"""The directive `scenario-keys`: every table of a scenario with its keys, units and defaults."""

import inspect
import re
from collections.abc import Iterable
from typing import Any

import msgspec
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from jaxtube.scenario.refusal import literal
from jaxtube.scenario.tree import Scenario

UNITS = {
    "_mps2": "m/s²",
    "_radps": "rad/s",
    "_mps": "m/s",
    "_deg": "deg",
    "_m": "m",
    "_s": "s",
}
"""By the end of a key."""

BOUNDS = {"gt": "above", "ge": "at least", "lt": "below", "le": "at most"}
FILLED_IN = {
    "reference.duration_s": "30.0, or as long as the file",
    "slip.nominal_right": "0.2, or the middle of `right`",
    "slip.nominal_left": "0.2, or the middle of `left`",
}
"""Defaults that depend on other keys."""

HEAD = "| key | unit | takes | default |\n|---|---|---|---|\n"


def find_unit(key: str) -> str:
    """Return the unit that a key ends in; empty for a number without one."""
    return next((unit for end, unit in UNITS.items() if key.endswith(end)), "")


def describe_kind(kind: msgspec.inspect.Type) -> str:
    """Return in words what values a key takes."""
    match kind:
        case msgspec.inspect.FloatType() | msgspec.inspect.IntType():
            return _describe_number(kind)
        case msgspec.inspect.LiteralType(values):
            return ", ".join(f"`{literal(value)}`" for value in sorted(values))
        case msgspec.inspect.UnionType(types):
            named = [each for each in types if not isinstance(each, msgspec.inspect.NoneType)]
            return " or ".join(describe_kind(each) for each in named)
        case msgspec.inspect.TupleType(items):
            return f"a list of {len(items)}: {_join_once(map(describe_kind, items))}"
        case msgspec.inspect.VarTupleType(item):
            return f"a list: {describe_kind(item)}"
        case msgspec.inspect.StructType(cls):
            return f"tables as below, `{cls.__name__}`"
        case msgspec.inspect.BoolType():
            return "`true`, `false`"
        case msgspec.inspect.StrType():
            return "a text"
    raise TypeError(f"{kind}: has no words here")


def write_reference() -> str:
    """Return the reference of all tables in MyST, a heading each."""
    tables = {field.name: field.type.cls for field in _list_fields(Scenario)}
    parts = []
    for section, table in tables.items():
        parts.append(
            f"## `[{section}]`\n\n{_read_docstring(table)}\n\n{_write_table(table, section)}"
        )
        parts += [
            f"### A table of `{section}.{field.name}`\n\n{_read_docstring(inner)}\n\n"
            f"{_write_table(inner, f'{section}.{field.name}')}"
            for field in _list_fields(table)
            for inner in _find_tables(field.type)
        ]
    return "\n\n".join(parts)


class ScenarioKeys(SphinxDirective):
    """Puts the reference of all tables in its place."""

    def run(self) -> list[nodes.Node]:
        """Return the parsed reference."""
        return self.parse_text_to_nodes(write_reference(), allow_section_headings=True)


def setup(app: Sphinx) -> dict[str, bool]:
    """Add the directive."""
    app.add_directive("scenario-keys", ScenarioKeys)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _list_fields(table: type[msgspec.Struct]) -> tuple[msgspec.inspect.Field, ...]:
    kind = msgspec.inspect.type_info(table)
    assert isinstance(kind, msgspec.inspect.StructType)
    return kind.fields


def _find_tables(kind: msgspec.inspect.Type) -> list[type[msgspec.Struct]]:
    """Return the table whose values a key lists, if it lists any."""
    if isinstance(kind, msgspec.inspect.VarTupleType):
        item = kind.item_type
        return [item.cls] if isinstance(item, msgspec.inspect.StructType) else []
    return []


def _read_docstring(table: type) -> str:
    """Return the docstring of a table, with what MyST would read as markup escaped outside of
    backticks."""
    parts = (inspect.getdoc(table) or "").split("`")
    return "`".join(
        part if number % 2 else re.sub(r"([*_\[\]|<>])", r"\\\1", part)
        for number, part in enumerate(parts)
    )


def _write_table(table: type[msgspec.Struct], section: str) -> str:
    rows = []
    for field in _list_fields(table):
        takes = describe_kind(field.type).replace("|", "\\|")
        default = _write_default(field, section)
        rows.append(f"| `{field.name}` | {find_unit(field.name)} | {takes} | {default} |")
    return HEAD + "\n".join(rows)


def _write_default(field: msgspec.inspect.Field, section: str) -> str:
    filled_in = FILLED_IN.get(f"{section}.{field.name}")
    if filled_in:
        return filled_in
    if field.required:
        return "none, must be given"
    return "left out" if field.default is None else f"`{literal(field.default)}`"


def _describe_number(kind: Any) -> str:
    noun = "a whole number" if isinstance(kind, msgspec.inspect.IntType) else "a number"
    bounds = [
        f"{word} {bound:g}"
        for name, word in BOUNDS.items()
        if (bound := getattr(kind, name)) is not None
    ]
    return f"{noun} {' and '.join(bounds)}".strip()


def _join_once(words: Iterable[str]) -> str:
    """Join different words; equal ones stand once."""
    return ", ".join(dict.fromkeys(words))
