"""Python and the packages that jaxtube asks for, read from its own metadata: the versions asked for
are written in pyproject.toml alone."""

from __future__ import annotations

import importlib.metadata
import platform
from collections.abc import Iterator

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from jaxtube.experiments.doctor.finding import Finding
from jaxtube.experiments.run.folder import version

PACKAGE = "jaxtube"
NOT_OF_USERS = ("test", "docs")
"""Extras for those who work on jaxtube itself."""
REINSTALL = "install it: pip install -e . in a checkout, or pip install jaxtube"


def find_packages() -> list[Finding]:
    """Return Python, the packages needed, and one finding for each extra."""
    try:
        metadata = importlib.metadata.metadata(PACKAGE)
    except importlib.metadata.PackageNotFoundError:
        return [Finding(PACKAGE, "missing", "is not installed", REINSTALL)]
    requirements = [Requirement(text) for text in importlib.metadata.requires(PACKAGE) or ()]
    needed = [each for each in requirements if each.marker is None or each.marker.evaluate()]
    extras = [name for name in metadata.get_all("Provides-Extra") or () if name not in NOT_OF_USERS]
    return [
        _judge_python(metadata["Requires-Python"] or ""),
        Finding(PACKAGE, "ok", metadata["Version"] or ""),
        *map(judge_package, needed),
        *(_judge_extra(name, requirements) for name in extras),
    ]


def _judge_python(asked: str) -> Finding:
    found = platform.python_version()
    if SpecifierSet(asked).contains(found, prereleases=True):
        return Finding("python", "ok", found)
    return Finding("python", "wrong", f"{found}, asked for is {asked}", f"install Python {asked}")


def judge_package(requirement: Requirement) -> Finding:
    """Return whether a package is there, in a version that was asked for."""
    found = version(requirement.name)
    cure = f"pip install '{requirement.name}{requirement.specifier}'"
    if found is None:
        return Finding(requirement.name, "missing", "is not installed", cure)
    if requirement.specifier.contains(found, prereleases=True):
        return Finding(requirement.name, "ok", found)
    words = f"{found}, asked for is {requirement.specifier}"
    return Finding(requirement.name, "wrong", words, cure)


def _judge_extra(name: str, requirements: list[Requirement]) -> Finding:
    """Return whether the packages of an extra are there."""
    found = list(map(judge_package, _select(name, requirements)))
    absent = [each for each in found if each.state != "ok"]
    title = f"extra {name}"
    if not absent:
        words = ", ".join(f"{each.name} {each.words}" for each in found)
        return Finding(title, "ok", words, is_needed=False)
    words = ", ".join(f"{each.name} {each.words}" for each in absent)
    return Finding(title, "missing", words, f"pip install 'jaxtube[{name}]'", is_needed=False)


def _select(extra: str, requirements: list[Requirement]) -> Iterator[Requirement]:
    """Yield what an extra asks for here, with what its packages ask for in extras of their own, as
    jax[cuda12] does."""
    for requirement in requirements:
        marker = requirement.marker
        if not marker or marker.evaluate() or not marker.evaluate({"extra": extra}):
            continue
        yield requirement
        if version(requirement.name):
            texts = importlib.metadata.requires(requirement.name) or ()
            for inner in requirement.extras:
                yield from _select(inner, [Requirement(text) for text in texts])
