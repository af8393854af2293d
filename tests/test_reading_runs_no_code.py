"""What SECURITY.md says of files that are read: no code of theirs can run."""

import ast
from functools import cache
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
IN_MEMORY = {"jaxtube/synthesis/disturbance.py", "jaxtube/synthesis/learnt_slips.py"}
"""Modules that pickle values of their own, and never a file."""
RUNNING = {"eval", "exec", "compile", "__import__"}
RUNS_ITS_OWN = {"jaxtube/exporting/replay.py"}
"""Modules that run a module by its path: one that has just been written, as SECURITY.md says."""
LOADERS = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "marshal", "shelve", "yaml"}


@cache
def read_trees():
    paths = [path for package in ("jaxtube", "sets") for path in (ROOT / package).rglob("*.py")]
    return {path.relative_to(ROOT).as_posix(): ast.parse(path.read_text("utf-8")) for path in paths}


def find_calls(tree):
    return [node for node in ast.walk(tree) if isinstance(node, ast.Call)]


def test_nothing_evaluates_text():
    found = [
        f"{name}:{call.lineno}"
        for name, tree in read_trees().items()
        for call in find_calls(tree)
        if isinstance(call.func, ast.Name) and call.func.id in RUNNING
    ]
    assert found == []


def test_modules_are_run_by_their_path_where_it_is_said_alone():
    found = {
        name
        for name, tree in read_trees().items()
        for call in find_calls(tree)
        if isinstance(call.func, ast.Attribute) and call.func.attr in ("exec_module", "load_module")
    }
    assert found == RUNS_ITS_OWN


def test_libraries_whose_files_are_code_are_imported_by_the_named_modules_alone():
    found = set()
    for name, tree in read_trees().items():
        for node in ast.walk(tree):
            modules = []
            if isinstance(node, ast.Import):
                modules = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                modules = [node.module or ""]
            if any(module.split(".")[0] in LOADERS for module in modules):
                found.add(name)
    assert found == IN_MEMORY


def test_arrays_are_loaded_without_pickles():
    loads = [
        (name, call)
        for name, tree in read_trees().items()
        for call in find_calls(tree)
        if ast.unparse(call.func) in ("np.load", "numpy.load", "np.loadtxt", "np.genfromtxt")
    ]
    assert loads
    for name, call in loads:
        options = {word.arg: ast.unparse(word.value) for word in call.keywords}
        assert options.get("allow_pickle") == "False", f"{name}:{call.lineno}"


def test_an_array_of_objects_is_refused_where_results_are_read(tmp_path):
    """The law that the others rest on: numpy refuses what it would have to unpickle."""
    np.savez(tmp_path / "arrays.npz", errors=np.array([object()]))
    with np.load(tmp_path / "arrays.npz", allow_pickle=False) as file, pytest.raises(ValueError):
        file["errors"]
