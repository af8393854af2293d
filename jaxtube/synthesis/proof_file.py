"""`certificate.json`: a design and its proof as fractions, and beside it the program that checks
them with Python's standard library alone.

The format is that of `sets/checker`, where each number is said to be what it is for. What the
checker knows nothing of, the file names under `unchecked`, and the checker refuses it.

Source: new.
"""

from __future__ import annotations

import json
import shutil
from fractions import Fraction
from pathlib import Path
from typing import Any

from jaxtube.arguments import describe_type
from jaxtube.atomic import write_atomically
from jaxtube.progress import announce
from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.proof_parts import describe_design, describe_model, describe_robot
from jaxtube.synthesis.proof_search import (
    CHECKER,
    PROGRAMS,
    load_checker,
    prove_motions,
    prove_plans,
    prove_sets,
)

FILE = "certificate.json"
FORMAT = "jaxtube certificate 1"
CHECKED_OF_MODEL = {
    "controller.discretisation": "euler",
    "controller.input_map": "paper",
    "controller.restart": True,
    "controller.has_observer": False,
    "robot.obeys_at_once": True,
    "robot.wheel_acceleration_max_mps2": None,
    "slip.is_learnt": False,
}
"""What the checker knows of scenarios whose W is assumed, by their fields."""
CHECKED = {
    "controller.model": "exact_jacobian",
    "controller.input_map": "x_exact",
    "controller.tube": "sequence",
    "controller.terminal": "T-A",
    "controller.restart": True,
    "controller.has_observer": False,
    "disturbance.bound": "computed",
    "robot.obeys_at_once": True,
    "robot.wheel_acceleration_max_mps2": None,
}
"""What the checker knows, by the scenario's fields."""


def write_certificate(design: Design, folder: str | Path, name: str = "") -> Path:
    """Write `certificate.json` into a folder, with the programs that check it; return its path.

    Args:
        design: certified for the robot or for its model.
        folder: is made if it is missing.
        name: of the design, as the checker says it.

    Raises:
        ValueError: one line, where nothing is certified, or no proof is found.
    """
    if not isinstance(design, Design):
        raise ValueError(f"design: is {describe_type(design)}; give jt.design(scenario)")
    if not (design.certificate.holds_for_robot or design.certificate.holds_for_model):
        raise ValueError(
            "design: is not certified, so that there is no proof to write; see its certificate"
        )
    path = Path(folder) / FILE
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps(_write_numbers(describe_proof(design, name)), indent=1) + "\n"
    write_atomically(path, lambda file: file.write(text.encode()))
    for program in PROGRAMS:
        shutil.copyfile(CHECKER / program, path.with_name(program))
    return path


def describe_proof(design: Design, name: str = "") -> dict[str, Any]:
    """Return the certificate with its proof, numbers as fractions."""
    scenario = design.problem.scenario
    unchecked = list_unchecked(design)
    head = {"format": FORMAT, "name": name or "design"}
    if unchecked:
        return {**head, "unchecked": unchecked}
    certificate = {**head, **describe_robot(design.problem)}
    is_of_model = concerns_model(scenario)
    certificate |= describe_model(design) if is_of_model else describe_design(design)
    announce("proving the certificate for its file")
    try:
        if not is_of_model:
            for band in certificate["bands"]:
                prove_motions(certificate, band)
            prove_sets(certificate)
        prove_plans(certificate)
    except load_checker("check_intervals.py").Refused as refusal:
        raise ValueError(f"design: its certificate cannot be written: {refusal}") from None
    return certificate


def list_unchecked(design: Design) -> dict[str, str]:
    """Return the fields of a design's scenario that the checker knows nothing of, with their
    values, and its verdict where the checker proves no such verdict."""
    scenario = design.problem.scenario
    is_of_model = concerns_model(scenario)
    unchecked = {}
    for field, known in (CHECKED_OF_MODEL if is_of_model else CHECKED).items():
        table, key = field.split(".")
        value = getattr(getattr(scenario, table), key)
        if value != known:
            unchecked[field] = str(value)
    has_gains = scenario.controller.tracking_gains or scenario.operating.bands
    if not (has_gains or is_of_model):
        unchecked["controller.tracking_gains"] = "none"
    if not (design.certificate.holds_for_robot or is_of_model):
        unchecked["verdict"] = "for the model alone, though W is computed"
    return unchecked


def concerns_model(scenario: Scenario) -> bool:
    """Return whether a scenario promises something of a linear model alone, whose W is assumed."""
    is_assumed = scenario.disturbance.bound == "assumed"
    return is_assumed and scenario.controller.model in ("paper", "consistent")


def _write_numbers(value: Any) -> Any:
    """Return a description with its numbers written p/q."""
    if isinstance(value, dict):
        return {name: _write_numbers(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_write_numbers(entry) for entry in value]
    return str(value) if isinstance(value, Fraction | int) else value
