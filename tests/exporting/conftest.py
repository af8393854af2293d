"""Exported controllers that several files look at."""

import pytest
from c_controller import CController, compile_c

import jaxtube as jt
from jaxtube.exporting.replay import load_controller


@pytest.fixture(scope="session")
def certified():
    """The design of the scenario `certified`, on its first turn to the other circle."""
    return jt.design(jt.load("certified", ["reference.duration_s=16"]))


@pytest.fixture(scope="session")
def exported(certified, tmp_path_factory):
    """Its controller."""
    return jt.export(certified, tmp_path_factory.mktemp("exported") / "controller", "certified")


@pytest.fixture
def controller(exported):
    """The controller in NumPy, before its first step."""
    return load_controller(exported.folder).Controller(exported.folder / "controller.npz")


@pytest.fixture(scope="session")
def library(exported, tmp_path_factory):
    """The controller in C, compiled."""
    return compile_c(exported.folder, tmp_path_factory.mktemp("compiled") / "controller.so")


@pytest.fixture
def c_controller(library):
    """The controller in C, before its first step."""
    return CController(library)
