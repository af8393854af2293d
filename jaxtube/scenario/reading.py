"""Find, read and override a scenario file; every refusal is one line with file, key, value and
cure."""

import os
import re
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import msgspec

from jaxtube.scenario.folders import find_scenario
from jaxtube.scenario.nearest import ask_if_meant, find_nearest, offer
from jaxtube.scenario.refusal import refusal
from jaxtube.scenario.tree import Scenario
from jaxtube.scenario.validation import find_default, validate

FILE_KEYS = frozenset({"reference.file", "slip.recording"})
"""Keys that name a file."""


def load(name_or_path: str | Path, overrides: str | Iterable[str] = ()) -> Scenario:
    """Read a scenario by its name, by the path of its TOML file, or from a folder.

    Args:
        name_or_path: a name that `names` lists, a path that ends in `.toml`, or the folder of a
            saved result or of a run.
        overrides: texts such as `controller.horizon=7`, or one of them; values are TOML, bare words
            are strings.

    Returns:
        The validated scenario. A relative `reference.file` or `slip.recording` starts at the folder
        of the scenario file, in an override at the current folder, and is made absolute.

    Raises:
        ScenarioError: one line.
    """
    path = find(name_or_path)
    source = str(name_or_path)
    tables = _read(path, source)
    _make_files_absolute(tables, path.parent, FILE_KEYS)
    values = _parse_overrides([overrides] if isinstance(overrides, str) else overrides)
    return _override(tables, values, source)


def replace(scenario: Scenario, values: Mapping[str, Any]) -> Scenario:
    """Return a scenario with other values, validated as a file is.

        replace(scenario, {"controller.horizon": 7, "slip.process": "walk"})

    Args:
        scenario: the scenario to start from; it stays as it is.
        values: dotted key -> value, or section -> section. Numbers, texts, lists, numpy arrays and
            parts of other scenarios are taken. A relative `reference.file` or `slip.recording`
            starts at the current folder.

    Returns:
        The scenario; without a `reference.duration_s` of its own a `reference.shape` that becomes
        "file" brings the duration of its recording.

    Raises:
        ScenarioError: one line.
    """
    plain = {}
    for key, value in values.items():
        as_python = value.tolist() if hasattr(value, "tolist") else value
        plain[key] = msgspec.to_builtins(as_python)
    return _override(msgspec.to_builtins(scenario), plain, "scenario")


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

    Raises:
        ScenarioError: for a name that no scenario has, and for a folder that holds no scenario, or
            one that was changed there.
    """
    text = str(name_or_path)
    if text.endswith(".toml"):
        return Path(text)
    known = names()
    if text not in known and _is_folder(text):
        return find_scenario(Path(text))
    if text not in known:
        cure = (
            f"{offer(text, known)}, or give the path of a file that ends in .toml, or of a folder"
        )
        raise refusal("scenario", "name", text, "no scenario has this name", cure)
    return experiments_folder() / text / "scenario.toml"


def _is_folder(text: str) -> bool:
    """Tell whether a text names a folder; one that no path can be does not."""
    return os.path.isdir(text)


def _read(path: Path, source: str) -> dict[str, Any]:
    """Read the tables of a TOML file; a byte order mark at its start is skipped."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8 text"
        problem = f"cannot be read ({reason})"
        beside = [*map(str, path.parent.glob("*.toml")), *names()]
        meant = [] if os.path.exists(path) else find_nearest(str(path), beside)
        cure = ask_if_meant(meant) or "give a readable file in UTF-8"
        raise refusal(source, "scenario", str(path), problem, cure) from None
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        number, line = _locate(str(error), text)
        reason = re.sub(r" \(at .*\)$", "", str(error))
        problem = f"not TOML ({reason})"
        raise refusal(source, f"line {number}", line, problem, "correct this line") from None


def _locate(message: str, text: str) -> tuple[int, str]:
    """Return number and text of the line that an error of TOML is about."""
    lines = text.rstrip().splitlines() or [""]
    place = re.search(r"at line (\d+)", message)
    number = min(int(place[1]), len(lines)) if place else len(lines)
    return number, lines[number - 1].strip()


def _parse_overrides(overrides: Iterable[str]) -> dict[str, Any]:
    """Read texts such as `controller.horizon=7` as dotted key -> value; the later one wins."""
    values = {}
    for text in overrides:
        left, equals, right = text.partition("=")
        key = left.strip()
        value = right.strip()
        if not key or not equals:
            cure = "write controller.horizon=7"
            raise refusal("override", key or "key", value, "no key and value", cure)
        values[key] = _parse_value(key, value)
    return values


def _parse_value(key: str, text: str) -> Any:
    """Read a value as TOML; text that is not TOML is a string, and so is a bare word such as true
    where a string belongs."""
    try:
        table = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return text
    value = table["value"]
    wants_string = isinstance(find_default(key), str) and not isinstance(value, str)
    return text if wants_string or len(table) > 1 else value


def _override(tables: dict[str, Any], values: Mapping[str, Any], source: str) -> Scenario:
    """Write overrides into tables and validate them.

    Args:
        tables: of the scenario, changed in place.
        values: dotted key -> value.
        source: where the tables came from, for messages.
    """
    for key, value in values.items():
        section, dot, name = key.partition(".")
        table = tables.setdefault(section, {}) if dot else tables
        if isinstance(table, dict):
            table[name or section] = value
    if values.get("reference.shape") == "file" and "reference.duration_s" not in values:
        # The duration that stands there was meant for another shape.
        tables["reference"].pop("duration_s", None)
    _make_files_absolute(tables, Path.cwd(), values)

    def find_source(key: str) -> str:
        place = f"{key.split('[')[0]}."
        is_override = any(f"{name}.".startswith(place) for name in values)
        return "override" if is_override else source

    return validate(tables, find_source)


def _make_files_absolute(tables: dict[str, Any], folder: Path, keys: Iterable[str]) -> None:
    """Let relative files start at a folder, those of `keys` that name one."""
    for key in FILE_KEYS.intersection(keys):
        section, _, name = key.partition(".")
        table = tables.get(section)
        file = table.get(name) if isinstance(table, dict) else None
        if isinstance(table, dict) and isinstance(file, str) and file:
            table[name] = str(Path.cwd() / folder / file)
