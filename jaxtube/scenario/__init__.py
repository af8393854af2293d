"""Scenarios: a TOML file and overrides become a frozen tree of validated numbers, `Scenario`."""

from jaxtube.scenario.reading import experiments_folder, find, load, names, replace
from jaxtube.scenario.reference_rules import check_reference_wheels
from jaxtube.scenario.refusal import ScenarioError
from jaxtube.scenario.tree import Scenario, to_toml, weight_matrix

__all__ = [
    "Scenario",
    "ScenarioError",
    "check_reference_wheels",
    "experiments_folder",
    "find",
    "load",
    "names",
    "replace",
    "to_toml",
    "weight_matrix",
]
