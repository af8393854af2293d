"""Docstrings as pages: what is indented deeper than the text before it is shown as it stands."""

import re
from itertools import pairwise

from sphinx.application import Sphinx

SECTION = re.compile(r"\s*(Args|Attributes|Raises|Returns|Source|Sources|Yields):$")
TYPES = re.compile(r"~?jaxlib\._jax\.|~?jaxtyping\.")
"""Modules in front of types that everyone knows without."""
COLON = "\ue000"
"""Stands for a colon of a property, which napoleon would take for the end of a type."""


def mark_literal_blocks(lines: list[str]) -> list[str]:
    """Return the lines with `::` before every block that is indented and stands alone.

    In plain text such a block is an example or a formula; reStructuredText takes it for a
    quotation.
    """
    marked = list(lines[:1])
    literal_depth = None
    for before, line in pairwise(lines):
        depth = len(line) - len(line.lstrip())
        if line.strip() and literal_depth is not None and depth < literal_depth:
            literal_depth = None
        if line.strip() and not before.strip() and literal_depth is None:
            text = next((known for known in reversed(marked) if known.strip()), "")
            text_depth = len(text) - len(text.lstrip())
            if depth > text_depth and not SECTION.match(text):
                marked += [" " * text_depth + "::", ""]
                literal_depth = depth
        marked.append(line)
    return marked


def escape_markup(lines: list[str]) -> list[str]:
    """Return the lines with the signs of products and absolute values escaped, which would be
    markup; what stands in backticks or deeper than a `::` is left alone."""
    escaped = []
    literal_depth = None
    for line in lines:
        depth = len(line) - len(line.lstrip())
        if line.strip() and literal_depth is not None and depth <= literal_depth:
            literal_depth = None
        if literal_depth is None:
            line = _escape_outside_backticks(line)
        if line.strip() == "::":
            literal_depth = depth
        escaped.append(line)
    return escaped


def rewrite(app: Sphinx, what: str, name: str, thing: object, options, lines: list[str]) -> None:
    """Rewrite a docstring before it is read."""
    lines[:] = escape_markup(mark_literal_blocks(lines))
    if what in ("attribute", "property"):
        lines[:1] = [line.replace(":", COLON) for line in lines[:1]]


def restore(app: Sphinx, what: str, name: str, thing: object, options, lines: list[str]) -> None:
    """Put colons back."""
    lines[:] = [line.replace(COLON, ":") for line in lines]


def shorten(app: Sphinx, what: str, name: str, thing: object, options, arguments, returned):
    """Shorten a signature: none for what only the library makes, and types by their usual names."""
    if arguments and (arguments == "(*args, **kwargs)" or "<factory>" in arguments):
        arguments = ""
    return tuple(text and TYPES.sub("", text) for text in (arguments, returned))


def skip(
    app: Sphinx, what: str, name: str, thing: object, is_skipped: bool, options
) -> bool | None:
    """Skip the fields of a named tuple, which its docstring describes."""
    text = getattr(thing, "__doc__", None) or ""
    return True if text.startswith("Alias for field number") else None


def setup(app: Sphinx) -> dict[str, bool]:
    """Rewrite before napoleon reads the sections, and restore after it."""
    app.connect("autodoc-process-docstring", rewrite, priority=100)
    app.connect("autodoc-process-docstring", restore, priority=900)
    app.connect("autodoc-process-signature", shorten)
    app.connect("autodoc-skip-member", skip, priority=100)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _escape_outside_backticks(line: str) -> str:
    parts = line.split("`")
    return "`".join(
        part if number % 2 else re.sub(r"([*|])", r"\\\1", part)
        for number, part in enumerate(parts)
    )
