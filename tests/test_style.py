"""One binding a line, read from the syntax trees."""

import ast
from functools import cache
from pathlib import Path

import measure
import pytest

ROOT = Path(__file__).parents[1]


@cache
def read_modules():
    """Return the modules; read by the first test that asks, not by every worker."""
    return [module for name in measure.PACKAGES for module in measure.read_modules(ROOT, name)]


def test_no_tuple_is_assigned_to_a_tuple():
    packed = [
        f"{module.name}:{node.lineno}"
        for module in read_modules()
        for node in measure.find_parallel_assignments(module.tree)
    ]
    assert packed == []


@pytest.mark.parametrize(
    ("line", "is_packed"),
    [
        ("a, b = x, y", True),
        ("a, b = (f(t) for t in ts)", True),
        ("a, b = [f(t) for t in ts]", True),
        ("a, b = b, a", False),
        ("x[i], x[j] = x[j], x[i]", False),
        ("a, b = f(x)", False),
        ("a, b = pair", False),
        ("a = x, y", False),
    ],
)
def test_packed_lines_are_told_from_unpacked_calls_and_swaps(line, is_packed):
    assert bool(measure.find_parallel_assignments(ast.parse(line))) == is_packed


def test_imports_are_absolute():
    relative = [
        f"{module.name}:{node.lineno}"
        for module in read_modules()
        for node in ast.walk(module.tree)
        if isinstance(node, ast.ImportFrom) and node.level
    ]
    assert relative == []
