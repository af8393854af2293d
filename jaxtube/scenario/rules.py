"""Laws that the type of a single key cannot state: between keys, on the weights, on the reference.

Two circles of radius r at speed V ask the wheels for V (1 +- b / (2 r)); both speeds lie in the
reference's box. A slip i that is off by a share d keeps the wheel turning the robot while i (1 + d)
< 1. Weights are symmetric, that of the error positive semidefinite, that of the inputs positive
definite.
"""

from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import numpy as np
from jaxtyping import Float

from .refusal import refusal
from .tree import Controller, Reference, Scenario, Slip, Weight

Refuse = Callable[[str, str, str], NoReturn]

# Wheel speeds on the edge of their box are inside it, and singular weights semidefinite, however
# they were rounded.
EDGE_MPS = 1e-9
EDGE_SHARE = 1e-9
EIGENVALUE_ROUNDING = 1e-12

ERROR_SIZE, INPUT_SIZE = 3, 2


def check(scenario: Scenario, refuse: Refuse) -> None:
    """Refuse the first key that breaks a law between keys: calls `refuse(key, problem, cure)`,
    which raises."""
    for section in ("robot", "reference"):
        _check_order(getattr(scenario, section), section, refuse)
    _check_slip(scenario.slip, refuse)
    _check_weights(scenario.controller, refuse)
    _check_operating(scenario, refuse)
    _check_gains(scenario.controller, refuse)
    _check_vertex_gains(scenario, refuse)
    _check_bands(scenario, refuse)
    if scenario.reference.duration_s < scenario.controller.dt_s:
        problem = f"is shorter than one step, controller.dt_s = {scenario.controller.dt_s}"
        refuse("reference.duration_s", problem, "run for at least one step")
    _check_shape(scenario, refuse)


def weight_matrix(weight: Weight) -> Float[np.ndarray, "n n"]:
    """Expand a weight, a list of n diagonal entries or of n rows, to its matrix.

    Raises: ValueError for anything else.
    """
    if not any(isinstance(row, tuple) for row in weight):
        return np.diag(np.array(weight, dtype=float))
    if all(isinstance(row, tuple) and len(row) == len(weight) for row in weight):
        return np.array(weight, dtype=float)
    raise ValueError(
        f"weight = {weight}: neither diagonal entries nor a square matrix; give n numbers or n rows of n"
    )


def check_reference_wheels(
    scenario: Scenario, slowest_mps: float, fastest_mps: float, source: str = "scenario"
) -> None:
    """Refuse a reference whose wheels leave the box that the reference promises.

    Args:
        slowest_mps, fastest_mps: extreme speeds of the two wheels over the whole reference.
        source: where the scenario came from, for the message.
    Raises: ScenarioError, one line.
    """

    def refuse(key: str, problem: str, cure: str) -> NoReturn:
        raise refusal(source, key, scenario.reference.speed_mps, problem, cure)

    _check_wheels(scenario.reference, slowest_mps, fastest_mps, refuse)


def _check_order(section, name: str, refuse: Refuse) -> None:
    low, high = section.wheel_speed_min_mps, section.wheel_speed_max_mps
    if not low < high:
        problem = f"is not below {name}.wheel_speed_max_mps = {high}"
        refuse(f"{name}.wheel_speed_min_mps", problem, "lower the minimum or raise the maximum")


def _check_slip(slip: Slip, refuse: Refuse) -> None:
    for side in ("right", "left"):
        largest = getattr(slip, f"nominal_{side}") * (1 + slip.relative_error)
        if largest >= 1:
            problem = f"with slip.relative_error = {slip.relative_error} the slip reaches {largest:.6g}, a spinning wheel"
            refuse(f"slip.nominal_{side}", problem, "keep nominal * (1 + relative_error) below 1")


def _check_operating(scenario: Scenario, refuse: Refuse) -> None:
    operating, noise = scenario.operating, scenario.noise
    for name in ("longitudinal_m", "lateral_m", "heading_deg"):
        limit, spread, cap = (
            getattr(section, name) for section in (scenario.constraints, noise, operating)
        )
        if spread >= limit:
            refuse(
                f"noise.{name}",
                f"leaves nothing of constraints.{name} = {limit}",
                "reduce it or widen the limit",
            )
        if cap is not None and cap > (limit - spread) * (1 + EDGE_SHARE):
            problem = f"with the noise of {spread} passes constraints.{name} = {limit}"
            refuse(f"operating.{name}", problem, f"give at most {limit - spread:.6g}")
    for names, cure in (
        (
            ("speed_deficit_min_mps", "speed_deficit_max_mps", "yaw_rate_deficit_radps"),
            "all three input caps or none",
        ),
        (
            ("turning_longitudinal_m", "turning_yaw_rate_radps"),
            "both or none, with the three input caps",
        ),
    ):
        given = [name for name in names if getattr(operating, name) is not None]
        missing = [name for name in names if name not in given]
        if given and (missing or operating.yaw_rate_deficit_radps is None):
            refuse(f"operating.{given[0]}", "is not enough alone", f"give {cure}")


def _check_bands(scenario: Scenario, refuse: Refuse) -> None:
    bands, controller = scenario.operating.bands, scenario.controller
    ends = [scenario.reference.wheel_speed_min_mps, *(band.below_mps for band in bands)]
    fastest = scenario.reference.wheel_speed_max_mps
    if bands and (sorted(set(ends)) != ends or not ends[-2] < fastest <= ends[-1]):
        problem = f"end at {ends[1:]} m/s"
        refuse("operating.bands", problem, "let below_mps grow up to reference.wheel_speed_max_mps")
    if bands and scenario.reference.certified_for == "path":
        refuse("operating.bands", "cover a box, not a path", 'set reference.certified_for = "box"')
    if bands and (controller.model, scenario.disturbance.bound) != ("exact_jacobian", "computed"):
        cure = 'set controller.model = "exact_jacobian" and disturbance.bound = "computed"'
        refuse("operating.bands", "need a computed bound and the exact Jacobian", cure)
    if bands and (
        controller.tracking_gains or scenario.operating.yaw_rate_deficit_radps is not None
    ):
        refuse(
            "operating.bands",
            "bring their own caps and gains",
            "leave out input caps and controller.tracking_gains",
        )


def _check_gains(controller: Controller, refuse: Refuse) -> None:
    if controller.tracking_gains and len(controller.tracking_gains) != 3:
        refuse("controller.tracking_gains", "are not three", "give [k1, k2, k3]")
    for name in ("tracking_gains", "vertex_gains"):
        if getattr(controller, name) and (controller.terminal, controller.tube) != (
            "T-A",
            "sequence",
        ):
            problem = "are tube and terminal gain at once, which terminal T-A with tube sequence allows alone"
            refuse(
                f"controller.{name}",
                problem,
                'set controller.terminal = "T-A" and controller.tube = "sequence"',
            )


def _check_vertex_gains(scenario: Scenario, refuse: Refuse) -> None:
    controller, gains = scenario.controller, scenario.controller.vertex_gains
    if gains and [len(gain) for gain in gains] != [INPUT_SIZE * ERROR_SIZE] * 4:
        refuse(
            "controller.vertex_gains",
            "are not four gains",
            "give four rows [k11, k12, k13, k21, k22, k23]",
        )
    if gains and (controller.tracking_gains or scenario.operating.bands):
        refuse(
            "controller.vertex_gains",
            "stand beside tracking gains or operating.bands",
            "leave out one of them",
        )
    affine = controller.model != "exact_jacobian" and controller.discretisation == "euler"
    if gains and not affine and scenario.reference.certified_for == "box":
        problem = "give loops that four vertices cover for a model affine in the wheel speeds alone"
        cure = 'set model = "consistent" and discretisation = "euler", or reference.certified_for = "path"'
        refuse("controller.vertex_gains", problem, cure)


def _check_weights(controller: Controller, refuse: Refuse) -> None:
    _check_weight("error_weight", controller.error_weight, ERROR_SIZE, False, refuse)
    _check_weight("input_weight", controller.input_weight, INPUT_SIZE, True, refuse)


def _check_weight(name: str, weight: Weight, size: int, definite: bool, refuse: Refuse) -> None:
    key = f"controller.{name}"
    try:
        matrix = weight_matrix(weight)
    except ValueError:
        matrix = np.empty((0, 0))
    if matrix.shape != (size, size):
        refuse(
            key,
            "has the wrong shape",
            f"give {size} diagonal entries or {size} rows of {size} numbers",
        )
    if (matrix != matrix.T).any():
        refuse(key, "is not symmetric", "give a symmetric matrix")
    smallest = float(np.linalg.eigvalsh(matrix)[0])
    rounding = EIGENVALUE_ROUNDING * np.abs(matrix).max()
    if definite and smallest <= rounding:
        refuse(
            key,
            f"is not positive definite, its smallest eigenvalue is {smallest:.6g}",
            "raise its diagonal",
        )
    if smallest < -rounding:
        refuse(
            key,
            f"is not positive semidefinite, its smallest eigenvalue is {smallest:.6g}",
            "raise its diagonal",
        )


def _check_shape(scenario: Scenario, refuse: Refuse) -> None:
    reference = scenario.reference
    if reference.shape == "file":
        _check_file(reference.file, refuse)
    if reference.shape == "two_circles":
        turn = scenario.robot.track_width_m / (2 * reference.radius_m)
        _check_wheels(
            reference, reference.speed_mps * (1 - turn), reference.speed_mps * (1 + turn), refuse
        )


def _check_wheels(reference: Reference, slowest: float, fastest: float, refuse: Refuse) -> None:
    low, high = reference.wheel_speed_min_mps, reference.wheel_speed_max_mps
    if not (low - EDGE_MPS <= slowest and fastest <= high + EDGE_MPS):
        problem = (
            f"the reference wheels run {slowest:.6g} to {fastest:.6g} m/s, outside "
            f"[reference.wheel_speed_min_mps, reference.wheel_speed_max_mps] = [{low:.6g}, {high:.6g}]"
        )
        refuse(
            "reference.speed_mps", problem, "change the speed, turn less sharply, or widen the box"
        )


def _check_file(file: str, refuse: Refuse) -> None:
    if not file:
        refuse(
            "reference.file",
            'is empty, and reference.shape is "file"',
            "name the file, or choose another shape",
        )
    try:
        Path(file).open("rb").close()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        refuse(
            "reference.file",
            f"cannot be read ({reason})",
            "name a readable file, relative to the scenario file",
        )
