"""How a scenario is refused: one line, `FILE: KEY = VALUE: what is wrong; cure`."""

import json
from collections.abc import Callable
from typing import Any, NoReturn

SHOWN_CHARACTERS = 60

Refuse = Callable[[str, str, str], NoReturn]
"""Called with (dotted key, problem, cure); raises."""


class ScenarioError(ValueError):
    """A scenario that cannot be used; the message is one line with file, key, value and cure."""


def refusal(source: str, key: str, value: Any, problem: str, cure: str) -> ScenarioError:
    """Compose the error of one refused value.

    Args:
        source: file, scenario name or "override".
        key: dotted key, such as `controller.horizon`.
        value: the refused value, shown as TOML.
        problem: a clause without a full stop.
        cure: a clause without a full stop.

    Returns:
        The error, its message in one line that every UTF-8 terminal can print.
    """
    shown = literal(value)
    if len(shown) > SHOWN_CHARACTERS:
        shown = shown[: SHOWN_CHARACTERS - 3] + "..."
    line = " ".join(f"{source}: {key} = {shown}: {problem}; {cure}".split())
    return ScenarioError(line.encode("utf-8", "backslashreplace").decode("utf-8"))


def literal(value: Any) -> str:
    """Return a value as a TOML literal; reading it back gives an equal value. Keys that have none
    are left out of tables."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        # JSON leaves the delete character as it is; TOML does not allow that.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list | tuple):
        entries = ", ".join(literal(entry) for entry in value)
        return f"[{entries}]"
    if isinstance(value, dict):
        given = {key: entry for key, entry in value.items() if entry is not None}
        entries = ", ".join(f"{key} = {literal(entry)}" for key, entry in given.items())
        return f"{{{entries}}}"
    return repr(value) if isinstance(value, int | float) else str(value)
