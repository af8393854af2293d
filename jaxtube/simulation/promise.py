"""What the certificate of a design promises of a closed loop: for which errors, to which
controller."""

from __future__ import annotations

import dataclasses

import numpy as np

from jaxtube.coordinates import describe_half_widths
from jaxtube.synthesis.parts import Design, TubeDesign


def limit_true_errors(design: Design, plant: str) -> Design:
    """Return the design with the E that its tube-MPC promises on a plant: the caps alone on
    "linear", which is measured without noise; on others caps and pose noise together."""
    if plant != "linear":
        return design
    problem = dataclasses.replace(design.problem, error_set=design.problem.operating_set)
    return dataclasses.replace(design, problem=problem)


def describe_error_limits(design: Design, plant: str) -> str:
    """Return the half widths of the E that true errors are judged by on a plant."""
    error_set = limit_true_errors(design, plant).problem.error_set
    return f"E is {describe_half_widths(error_set.support(np.eye(3)))}"


def describe_certificate(design: TubeDesign, controller: str) -> str:
    """Return the verdict on a design, and that it is not one on a controller other than its
    tube-MPC."""
    verdict = design.certificate.verdict
    if controller == "tube_mpc":
        return f"certificate: {verdict}"
    return f"certificate of the design's tube-MPC, not of this controller: {verdict}"
