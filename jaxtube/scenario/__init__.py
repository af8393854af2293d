"""Scenarios: a TOML file and overrides become a frozen tree of validated numbers, `Scenario`."""

from .reading import experiments_folder, find, load, names
from .refusal import ScenarioError
from .rules import check_reference_wheels, weight_matrix
from .tree import Scenario, to_toml

__all__ = [
    "Scenario",
    "ScenarioError",
    "check_reference_wheels",
    "experiments_folder",
    "find",
    "load",
    "names",
    "to_toml",
    "weight_matrix",
]
