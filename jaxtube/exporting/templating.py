"""Templates of the files of an export."""

from __future__ import annotations

from importlib.resources import files

import jinja2


def read_template(name: str) -> str:
    """Return a template as it stands."""
    return files("jaxtube.exporting").joinpath("templates", name).read_text(encoding="utf-8")


def render(name: str, **values: object) -> str:
    """Return a template with its values, each of which it must be given."""
    environment = jinja2.Environment(
        undefined=jinja2.StrictUndefined,
        autoescape=False,
        keep_trailing_newline=True,
        trim_blocks=True,
    )
    return environment.from_string(read_template(name)).render(**values)
