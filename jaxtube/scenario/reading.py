"""Find, read and override a scenario file; every refusal is one line with file, key, value and
cure."""

import difflib
import math
import re
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NoReturn, get_args, get_type_hints

import msgspec

from . import rules
from .refusal import literal, refusal
from .tree import Scenario

WORDS = {
    "int": "a whole number",
    "float": "a number",
    "str": "text",
    "bool": "true or false",
    "array": "a list",
}


def load(name_or_path: str | Path, overrides: Iterable[str] = ()) -> Scenario:
    """Read a scenario by its name or by the path of its TOML file.

    Args:
        name_or_path: a name that `names` lists, or a path that ends in `.toml`.
        overrides: texts such as `controller.horizon=7`; values are TOML, bare words are strings.
    Returns: the validated scenario. A relative `reference.file` starts at the scenario file, or at
        the current folder where it is overridden, and is made absolute.
    Raises: ScenarioError, one line.
    """
    path = find(name_or_path)
    tree = _read(path, str(name_or_path))
    overridden = _override(tree, overrides)

    def raise_refusal(key: str, value: Any, problem: str, cure: str) -> NoReturn:
        by_override = any(f"{name}.".startswith(f"{key.split('[')[0]}.") for name in overridden)
        raise refusal(
            "override" if by_override else str(name_or_path), key, value, problem, cure
        ) from None

    def refuse(key: str, problem: str, cure: str) -> NoReturn:
        section, name = key.split(".")
        raise_refusal(key, getattr(getattr(scenario, section), name), problem, cure)

    for key, value in _non_finite(tree):
        raise_refusal(key, value, "is not finite", "give a finite number")
    try:
        scenario = msgspec.convert(tree, Scenario)
    except msgspec.ValidationError as error:
        raise_refusal(*_explain(str(error), tree))
    scenario = _absolute(scenario, Path.cwd() if "reference.file" in overridden else path.parent)
    rules.check(scenario, refuse)
    return scenario


def names() -> list[str]:
    """List the scenarios that come with the project, in alphabetical order."""
    return sorted(path.parent.name for path in experiments_folder().glob("*/scenario.toml"))


def experiments_folder() -> Path:
    """Find the folder of the scenarios: inside an installed package, or beside it in a source
    checkout."""
    package = Path(__file__).parents[1]
    installed = package / "experiments" / "data"
    return installed if installed.is_dir() else package.parent / "experiments"


def find(name_or_path: str | Path) -> Path:
    """Locate the file of a scenario; a path is taken as it is.

    Raises: ScenarioError for a name that no scenario has.
    """
    text = str(name_or_path)
    if text.endswith(".toml"):
        return Path(text)
    known = names()
    if text not in known:
        cure = f"choose one of {', '.join(known)}, or give the path of a file that ends in .toml"
        raise refusal("command line", "scenario", text, "no scenario has this name", cure)
    return experiments_folder() / text / "scenario.toml"


def _read(path: Path, source: str) -> dict[str, Any]:
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8 text"
        raise refusal(
            source, "scenario", str(path), f"cannot be read ({reason})", "give a readable file"
        ) from None
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        number, line = _where(str(error), text)
        problem = re.sub(r" \(at .*\)$", "", str(error))
        raise refusal(
            source, f"line {number}", line, f"not TOML ({problem})", "correct this line"
        ) from None


def _where(message: str, text: str) -> tuple[int, str]:
    lines = text.rstrip().splitlines() or [""]
    found = re.search(r"at line (\d+)", message)
    number = min(int(found[1]), len(lines)) if found else len(lines)
    return number, lines[number - 1].strip()


def _override(tree: dict[str, Any], overrides: Iterable[str]) -> set[str]:
    """Write the overrides into the tree and return their keys."""
    keys = set()
    for text in overrides:
        key, equals, value = (part.strip() for part in text.partition("="))
        if not key or not equals:
            raise refusal(
                "override", key or "key", value, "no key and value", "write controller.horizon=7"
            )
        section, dot, name = key.partition(".")
        table = tree.setdefault(section, {}) if dot else tree
        if isinstance(table, dict):
            table[name or section] = _value(key, value)
        keys.add(key)
    return keys


def _value(key: str, text: str) -> Any:
    """Read a value as TOML; what is no TOML is a string, and so is a bare word such as true where a
    string belongs."""
    try:
        values = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return text
    wants_string = isinstance(_default(key), str) and not isinstance(values["value"], str)
    return text if wants_string or len(values) > 1 else values["value"]


def _absolute(scenario: Scenario, folder: Path) -> Scenario:
    reference = scenario.reference
    if not reference.file:
        return scenario
    file = str(Path.cwd() / folder / reference.file)
    return msgspec.structs.replace(
        scenario, reference=msgspec.structs.replace(reference, file=file)
    )


def _non_finite(node: Any, key: str = "") -> Iterator[tuple[str, float]]:
    if isinstance(node, dict):
        for name, child in node.items():
            yield from _non_finite(child, f"{key}.{name}" if key else name)
    elif isinstance(node, list):
        for index, child in enumerate(node):
            yield from _non_finite(child, f"{key}[{index}]")
    elif isinstance(node, float) and not math.isfinite(node):
        yield key, node


def _explain(message: str, tree: dict[str, Any]) -> tuple[str, Any, str, str]:
    """Turn msgspec's "Expected `int`, got `str` - at `$.controller.horizon`" into key, value,
    problem and cure."""
    text, _, place = message.partition(" - at `$")
    key = place.strip("`.")
    value: Any = tree
    for name in re.findall(r"\w+", key):
        value = value[int(name)] if isinstance(value, list) else value[name]
    unknown = re.fullmatch(r"Object contains unknown field `(.*)`", text, re.DOTALL)
    if unknown:
        full = f"{key}.{unknown[1]}" if key else unknown[1]
        return full, value[unknown[1]], "unknown key" if key else "unknown section", _suggest(full)
    if "." not in key:
        return key, value, "must be a table", f"write [{key}] and its keys below it"
    if text.startswith("Invalid enum value"):
        return key, value, "unknown choice", f"choose one of {', '.join(_choices(key))}"
    return key, value, _requirement(text), f"the default is {literal(_default(key))}"


def _requirement(text: str) -> str:
    expected = re.match(r"Expected `([^`]*)`([^,]*)", text)
    if not expected:
        return "is out of range"
    kinds, bound = expected.groups()
    return f"must be {' or '.join(WORDS[kind] for kind in kinds.split(' | '))}{bound}"


def _suggest(key: str) -> str:
    sections = Scenario.__struct_fields__
    known = [
        f"{section}.{name}"
        for section in sections
        for name in getattr(Scenario(), section).__struct_fields__
    ]
    same_name = [other for other in known if other.split(".")[1] == key.split(".")[-1]]
    close = same_name or difflib.get_close_matches(key, [*sections, *known], n=1, cutoff=0.6)
    return f"did you mean {close[0]}?" if close else f"the sections are {', '.join(sections)}"


def _choices(key: str) -> tuple[str, ...]:
    section, name = key.split(".")
    return get_args(get_type_hints(type(getattr(Scenario(), section)))[name])


def _default(key: str) -> Any:
    section, _, name = key.split("[")[0].partition(".")
    return getattr(getattr(Scenario(), section, None), name, None)
