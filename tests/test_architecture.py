"""The order of imports, read from the syntax trees: `sets` stands alone, and nothing points
upwards."""

import ast
import graphlib
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("jaxtube", "sets")
CHECKER = ROOT / "sets" / "checker"
PROGRAMS = {f"sets.checker.{path.stem}" for path in CHECKER.glob("*.py")}
"""Programs that run by themselves, beside the file that they check."""
FILES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))

ROOMS = (
    "atomic",
    "precision",
    "coordinates",
    "arguments",
    "progress",
    "columns",
    "sealed",
    "numpy_archive",
    "scenario",
    "storage",
    "recordings",
    "qp",
    "plant",
    "paths",
    "control",
    "systems",
    "synthesis",
    "simulation",
    "statistics",
    "identification",
    "witness",
    "falsification",
    "tuning",
    "results",
    "exporting",
    "figures",
    "reporting",
    "experiments",
)
"""A room may import from itself and from the rooms before it."""


class Import(NamedTuple):
    """One imported name, such as `jaxtube.plant.robot.Robot`, and whether it is imported inside a
    function."""

    name: str
    inside_function: bool

    def within(self, module: str) -> bool:
        return f"{self.name}.".startswith(f"{module}.")


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(
    tree: ast.AST, module: str, is_package: bool, inside_function: bool = False
) -> Iterator[Import]:
    """Yield every import of a module, at any depth, with relative names resolved."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.Import):
            yield from (Import(alias.name, inside_function) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            package = module.split(".") if is_package else module.split(".")[:-1]
            base = package[: len(package) - node.level + 1] if node.level else []
            origin = ".".join([*base, *([node.module] if node.module else [])])
            yield from (Import(f"{origin}.{alias.name}", inside_function) for alias in node.names)
        is_function = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
        yield from imports(node, module, is_package, inside_function or is_function)


def imports_of(path: Path) -> list[Import]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return list(imports(tree, module_name(path), path.name == "__init__.py"))


@cache
def read_graph() -> dict[str, list[Import]]:
    """Return the imports of every module; read by the first test that asks, not by every worker."""
    return {module_name(path): imports_of(path) for path in FILES}


def violations(importers: str, *forbidden: str, allowed: tuple[str, ...] = ()) -> list[str]:
    """List "importer -> imported" for imports of a forbidden module by modules of a package, save
    the allowed ones."""
    return [
        f"{module} -> {entry.name}"
        for module, entries in read_graph().items()
        if f"{module}.".startswith(f"{importers}.")
        for entry in entries
        if any(entry.within(name) for name in forbidden)
        and not any(entry.within(name) for name in allowed)
    ]


def test_imports_are_found_wherever_they_stand():
    source = (
        "import a.b as c\nfrom .d import e\nfrom ..f import g\nfrom . import h\n"
        "def function():\n    import i\nclass K:\n    def m(self):\n        from j import k\n"
        "if True:\n    try:\n        import l\n    finally:\n        pass\n"
    )
    found = set(imports(ast.parse(source), "p.q.r", is_package=False))
    outside = {"a.b", "p.q.d.e", "p.f.g", "p.q.h", "l"}
    assert found == {Import(name, False) for name in outside} | {
        Import("i", True),
        Import("j.k", True),
    }
    assert list(imports(ast.parse("from .d import e"), "p.q", is_package=True)) == [
        Import("p.q.d.e", False)
    ]
    assert Import("jaxtube.qp.solve", False).within("jaxtube.qp")
    assert not Import("jaxtyping.Float", False).within("jax")


def test_sets_knows_neither_jax_nor_jaxtube():
    assert violations("sets", "jax", "jaxlib", "jaxtube") == []


def test_inside_sets_everything_rests_on_polytope_alone():
    assert violations("sets.frame", "sets") == []
    assert violations("sets.polytope", "sets", allowed=("sets.frame",)) == []
    for module in ("tubes", "invariant", "certificate"):
        assert (
            violations(f"sets.{module}", "sets", allowed=("sets.polytope", f"sets.{module}")) == []
        )
    programs = ("sets.lyapunov", "sets.riccati", "sets.semidefinite")
    assert violations("sets.lmi", "sets", allowed=programs) == []
    assert violations("sets.lyapunov", "sets", allowed=("sets.semidefinite",)) == []
    assert violations("sets.semidefinite", "sets") == violations("sets.riccati", "sets") == []
    assert violations("sets.exact", "sets") == violations("sets.interval", "sets") == []


def test_what_runs_on_line_imports_no_sets():
    for room in ("qp", "plant", "control"):
        assert violations(f"jaxtube.{room}", "sets") == []


def test_the_qp_knows_no_robot():
    assert violations("jaxtube.qp", *PACKAGES, allowed=("jaxtube.qp",)) == []


def test_nothing_outside_experiments_imports_experiments():
    lines = violations("jaxtube", "jaxtube.experiments") + violations("sets", "jaxtube.experiments")
    assert [line for line in lines if not line.startswith("jaxtube.experiments")] == []


def test_cvxpy_is_an_oracle_of_the_tests_alone():
    assert violations("sets", "cvxpy") + violations("jaxtube", "cvxpy") == []


def test_every_room_has_a_place_in_the_order():
    names = {module.split(".")[1] for module in read_graph() if module.startswith("jaxtube.")}
    assert names == set(ROOMS)


def is_lookup_of_a_drawing(entry: Import) -> bool:
    """Say whether a result looks up how it is drawn, at the moment when it is asked to."""
    return entry.inside_function and entry.within("jaxtube.figures")


def test_no_import_points_to_a_later_room():
    level = {f"jaxtube.{name}": number for number, name in enumerate(ROOMS)}
    upwards = [
        f"{module} -> {entry.name}"
        for module, entries in read_graph().items()
        for entry in entries
        if not is_lookup_of_a_drawing(entry)
        for name, number in level.items()
        if entry.within(name) and number > level.get(".".join(module.split(".")[:2]), len(ROOMS))
    ]
    assert upwards == []


def test_no_modules_import_each_other():
    def defining_module(entry: Import) -> str | None:
        return max((name for name in read_graph() if entry.within(name)), key=len, default=None)

    edges = {
        module: {defining_module(entry) for entry in entries if not is_lookup_of_a_drawing(entry)}
        - {None}
        for module, entries in read_graph().items()
    }
    assert list(graphlib.TopologicalSorter(edges).static_order())


@pytest.mark.parametrize("package", PACKAGES)
def test_the_package_is_marked_as_typed(package):
    assert (ROOT / package / "py.typed").exists()


def test_the_checker_of_certificates_imports_the_standard_library_and_itself_alone():
    beside = {name.split(".")[-1] for name in PROGRAMS}
    for program in PROGRAMS:
        for entry in read_graph()[program]:
            first = entry.name.split(".")[0]
            assert first in sys.stdlib_module_names or first in beside, entry.name


@pytest.mark.parametrize("program", sorted(path.name for path in CHECKER.glob("*.py")))
def test_the_checker_of_certificates_can_be_read_in_one_sitting(program):
    assert len((CHECKER / program).read_text(encoding="utf-8").splitlines()) <= 300


def test_sets_imports_and_works_where_jax_is_absent():
    names = read_graph()
    modules = [name for name in names if f"{name}.".startswith("sets.") and name not in PROGRAMS]
    blocked = (
        "import sys; sys.modules['jax'] = sys.modules['jaxlib'] = sys.modules['jaxtube'] = None; "
    )
    subprocess.run(
        [sys.executable, "-c", blocked + f"import {', '.join(modules)}"], check=True, cwd=ROOT
    )
