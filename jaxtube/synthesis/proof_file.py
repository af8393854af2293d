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
from jaxtube.synthesis.proof_parts import describe_design, describe_mixed, describe_robot
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
CHECKED = {
    "controller.restart": True,
    "robot.wheel_acceleration_max_mps2": None,
}
"""What the checker knows, by the scenario's fields."""
OF_LAWS = {
    "controller.model": "exact_jacobian",
    "controller.input_map": "x_exact",
    "controller.tube": "sequence",
    "controller.terminal": "T-A",
    "disturbance.bound": "computed",
}
"""Besides, where the law u = K e has a set of its own."""
OF_MIXED = {"controller.discretisation": "euler", "slip.is_learnt": False}
"""Besides, of gains that are mixed."""
OF_ASSUMED = {"controller.has_observer": False, "robot.obeys_at_once": True}
"""Besides, where W is assumed: an estimate, lag and delay are proved of the robot."""


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
    certificate |= describe_mixed(design) if mixes_gains(scenario) else describe_design(design)
    announce("proving the certificate for its file")
    try:
        if scenario.disturbance.bound == "computed":
            for band in certificate["bands"]:
                prove_motions(certificate, band)
        if "sets" in certificate:
            prove_sets(certificate)
        prove_plans(certificate)
    except load_checker("check_intervals.py").Refused as refusal:
        raise ValueError(f"design: its certificate cannot be written: {refusal}") from None
    return certificate


def list_unchecked(design: Design) -> dict[str, str]:
    """Return the fields of a design's scenario that the checker knows nothing of, with their
    values, and its verdict where the checker proves no such verdict."""
    scenario = design.problem.scenario
    is_mixed = mixes_gains(scenario)
    is_computed = scenario.disturbance.bound == "computed"
    wanted = {**CHECKED, **(OF_MIXED if is_mixed else OF_LAWS)}
    if is_mixed:
        wanted["controller.input_map"] = "x_exact" if is_computed else "paper"
        wanted["controller.model"] = "consistent" if is_computed else scenario.controller.model
    if not is_computed:
        wanted |= OF_ASSUMED
    unchecked = {}
    for field, known in wanted.items():
        table, key = field.split(".")
        value = getattr(getattr(scenario, table), key)
        if value != known:
            unchecked[field] = str(value)
    has_gains = scenario.controller.tracking_gains or scenario.operating.bands
    if not (has_gains or is_mixed):
        unchecked["controller.tracking_gains"] = "none"
    if is_computed and not design.certificate.holds_for_robot:
        unchecked["verdict"] = "for the model alone, though W is computed"
    return unchecked


def mixes_gains(scenario: Scenario) -> bool:
    """Return whether the model of a scenario is affine in the wheel speeds, so that loops are
    mixtures of those at corners whatever gains are mixed there."""
    return scenario.controller.model != "exact_jacobian" and not scenario.operating.bands


def _write_numbers(value: Any) -> Any:
    """Return a description with its numbers written p/q."""
    if isinstance(value, dict):
        return {name: _write_numbers(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_write_numbers(entry) for entry in value]
    return str(value) if isinstance(value, Fraction | int) else value
