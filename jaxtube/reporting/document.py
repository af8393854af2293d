"""A page as one HTML file that needs nothing else: style, script, pictures and laps are inside."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import jinja2
from markupsafe import Markup, escape

from jaxtube.reporting import pictures
from jaxtube.reporting.page import Page, Picture, Run

MOST_BYTES = 4_800_000
"""Of a page."""
TOLD_ELSEWHERE = ("title", "command line")
"""Entries of a manifest that a page tells in places of their own."""
OVERHEAD = 120_000
"""Of a page without pictures, laps and printed text, at most."""


class Shown(NamedTuple):
    """A figure in a page; without an address it stays in the run's folder and is linked."""

    picture: Picture
    address: str
    width: int
    height: int


def render(page: Page, run: Run) -> str:
    """Return a page as HTML, smaller than MOST_BYTES.

    All text is escaped: none of it can become markup.

    Args:
        page: what the command found.
        run: what is known of the run itself.
    """
    player = encode_data(page.player) if page.player else ""
    room = MOST_BYTES - OVERHEAD - len(player) - 2 * len(run.printed)
    template = _environment().get_template("page.html")
    return template.render(
        page=page,
        run=run,
        player=player,
        shown=list(_embed(run.pictures, room)),
        environment=[
            entry for entry in _list_environment(run.manifest) if entry[0] not in TOLD_ELSEWHERE
        ],
        command=run.manifest.get("command_line", ""),
        style=_read("page.css"),
        script=_read("player.js") if page.player else "",
    )


def mark_code(text: str) -> Markup:
    """Return text, escaped, with what stands between backticks as code."""
    parts = [escape(part) for part in text.split("`")]
    if len(parts) % 2 == 0:
        return escape(text)
    marked = [
        Markup("<code>{}</code>").format(part) if n % 2 else part for n, part in enumerate(parts)
    ]
    return Markup("").join(marked)


def encode_data(data: Mapping[str, Any]) -> Markup:
    """Return plain values as JSON that can stand inside a script element, whatever text they
    hold."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)


def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("jaxtube.reporting"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["code"] = mark_code
    return environment


def _read(name: str) -> Markup:
    """Return a file of the project's own that stands in the page as it is."""
    environment = _environment()
    assert environment.loader is not None
    return Markup(environment.loader.get_source(environment, name)[0])


def _embed(given: Sequence[Picture], room: int) -> Iterator[Shown]:
    """Put pictures into the page as long as there is room, the others as links."""
    for picture in given:
        address = pictures.embed(picture.png, room)
        room -= len(address)
        yield Shown(picture, address, *pictures.size(picture.png))


def _list_environment(manifest: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield names and values of what produced a run."""
    for key, value in manifest.items():
        name = f"{prefix}{key.replace('_', ' ')}"
        if isinstance(value, Mapping):
            yield from _list_environment(value, f"{name}: ")
        elif isinstance(value, list):
            yield name, ", ".join(map(str, value))
        else:
            yield name, str(value)
