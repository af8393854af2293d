"""The face of `sets`: every public name has one meaning, and importing it is quick."""

import importlib
import pkgutil
import subprocess
import sys
from types import ModuleType

import numpy as np
import pytest

import sets
import sets.robot


@pytest.mark.parametrize("package", [sets, sets.robot], ids=["sets", "sets.robot"])
def test_every_public_name_is_there(package: ModuleType):
    assert len(set(package.__all__)) == len(package.__all__)
    for name in package.__all__:
        assert hasattr(package, name)


def test_no_public_name_means_two_things():
    assert not set(sets.__all__) & set(sets.robot.__all__)
    for name in sets.__all__:
        assert not isinstance(getattr(sets, name), ModuleType)
    functions: dict[str, str] = {}
    for module in pkgutil.walk_packages(sets.__path__, "sets."):
        importlib.import_module(module.name)
    for path in [name for name in sys.modules if name.startswith("sets.")]:
        for name, value in vars(sys.modules[path]).items():
            if name.startswith("_") or getattr(value, "__module__", None) != path:
                continue
            assert functions.setdefault(name, path) == path, name


def test_importing_the_package_does_not_load_jax():
    check = "import sys, sets, sets.robot; sys.exit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", check], check=False).returncode == 0


def test_a_tube_a_cost_and_an_invariant_set_take_one_import():
    A = np.array([[1.0, 0.1], [0.0, 1.0]])
    B = np.array([[0.0], [0.1]])
    gain = sets.lqr_gain(A, B, np.eye(2), np.eye(1))
    loops = (A + B @ gain)[None]
    W = sets.Polytope.box(-0.01 * np.ones(2), 0.01 * np.ones(2))
    E = sets.Polytope.box(-np.ones(2), np.ones(2))
    invariant = sets.maximal_rpi(loops, E, W).polytope
    assert invariant is not None
    assert sets.invariance_margin(loops, W.vertices(), invariant) >= 0
    section = sets.hull_tube(loops, W, 10)[-1]
    minimal = sets.minimal_rpi_bound(loops, W, invariant.normals)
    assert minimal is not None
    assert (section.support(minimal.normals) <= minimal.offsets).all()
    assert E.pontryagin_difference(section).containment_margin(W) > 0
