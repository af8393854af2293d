"""Rules that the type of a single key cannot state: between keys, and on the weights.

A slip i that is off by a share d keeps the wheel turning the robot while i (1 + d) < 1. Weights are
symmetric, that of the error positive semidefinite, that of the inputs positive definite. Rules on
the reference are in `jaxtube.scenario.reference_rules`.
"""

import numpy as np

from jaxtube.scenario import reference_rules
from jaxtube.scenario.error_box import noise_bounds
from jaxtube.scenario.refusal import Refuse
from jaxtube.scenario.tree import (
    BandTable,
    ControllerTable,
    Operating,
    ReferenceTable,
    RobotTable,
    Scenario,
    Slip,
    Weight,
    weight_matrix,
)

CAP_ROUNDING = 1e-9
"""Share of a limit by which a cap may pass it: both are rounded numbers."""

EIGENVALUE_ROUNDING = 1e-12
"""What counts as the eigenvalue 0 of a weight, relative to its greatest entry."""

ERROR_SIZE = 3
INPUT_SIZE = 2

INPUT_CAPS = ("speed_deficit_min_mps", "speed_deficit_max_mps", "yaw_rate_deficit_radps")
COUPLING = ("turning_longitudinal_m", "turning_yaw_rate_radps")


def check_rules(scenario: Scenario, refuse: Refuse) -> None:
    """Refuse the first key that breaks a rule: call `refuse(key, problem, cure)`, which raises."""
    _check_order(scenario.robot, "robot", refuse)
    _check_order(scenario.reference, "reference", refuse)
    _check_slip(scenario.slip, refuse)
    _check_recording(scenario.slip, refuse)
    _check_learning(scenario, refuse)
    _check_actuation(scenario, refuse)
    _check_acceleration(scenario, refuse)
    _check_weights(scenario.controller, refuse)
    _check_limits(scenario, refuse)
    _check_complete(scenario.operating, refuse)
    _check_gains(scenario.controller, refuse)
    _check_vertex_gains(scenario, refuse)
    _check_cost(scenario.controller, refuse)
    _check_bands(scenario, refuse)
    reference_rules.check_reference(scenario, refuse)


def _check_order(section: RobotTable | ReferenceTable, name: str, refuse: Refuse) -> None:
    low = section.wheel_speed_min_mps
    high = section.wheel_speed_max_mps
    if not low < high:
        problem = f"is not below {name}.wheel_speed_max_mps = {high}"
        refuse(f"{name}.wheel_speed_min_mps", problem, "lower the minimum or raise the maximum")


def _check_slip(slip: Slip, refuse: Refuse) -> None:
    if slip.right is None or slip.left is None:
        _check_relative_slip(slip, refuse)
        return
    if slip.random != "true":
        problem = "goes with slip.relative_error, not with the intervals slip.right and slip.left"
        refuse("slip.random", problem, "give slip.measurement_error, or leave it out")
    absolute = slip.measurement_error or 0.0
    relative = slip.measurement_error_relative or 0.0
    for side in ("right", "left"):
        low, high = getattr(slip, side)
        nominal = getattr(slip, f"nominal_{side}")
        if not low <= high:
            refuse(f"slip.{side}", "has crossed ends", "give [least, greatest]")
        if not low <= nominal <= high:
            problem = f"lies outside slip.{side} = [{low}, {high}]"
            refuse(f"slip.nominal_{side}", problem, "give one inside, or leave it out")
        largest = high + absolute + relative * abs(high)
        if largest >= 1:
            problem = f"reaches {largest:.6g} as it is measured, a spinning wheel"
            refuse(f"slip.{side}", problem, "keep slip and measurement error together below 1")


def _check_recording(slip: Slip, refuse: Refuse) -> None:
    if slip.process != "recorded":
        return
    if not slip.recording:
        problem = 'is empty, and slip.process is "recorded"'
        refuse("slip.recording", problem, "name a file of slips, as `replay` writes it")
    reference_rules.check_readable("slip.recording", slip.recording, refuse)
    if slip.random == "measured":
        problem = 'leaves the true slip at its nominal value, and slip.process is "recorded"'
        refuse("slip.random", problem, 'set slip.random = "true"')


def _check_learning(scenario: Scenario, refuse: Refuse) -> None:
    slip = scenario.slip
    if not slip.is_learnt:
        return
    key = "slip.change_per_s"
    if not slip.has_intervals:
        problem = "is of a slip whose interval is not given"
        refuse(key, problem, "give the intervals slip.right and slip.left, too")
    if slip.is_measured:
        problem = "stands beside a measured slip, and what is measured need not be learnt"
        refuse(key, problem, "leave out one of the two")
    if slip.sideslip > 0:
        problem = "goes with no slip.sideslip, whose changes within a period look like slip"
        refuse(key, problem, "leave out one of the two")
    if not scenario.robot.obeys_at_once:
        problem = "goes with wheels that obey at once, for travel is learnt from what they are told"
        refuse(key, problem, "leave out robot.wheel_lag_s and robot.command_delay_s, or this key")
    if scenario.controller.has_observer:
        problem = "goes with the measured error, not with an estimate"
        refuse(key, problem, "leave out controller.observer_gain, or this key")
    if scenario.operating.bands:
        refuse(key, "goes with no operating.bands", "leave out one of the two")


def _check_relative_slip(slip: Slip, refuse: Refuse) -> None:
    for side, other in (("right", "left"), ("left", "right")):
        if getattr(slip, side) is not None:
            refuse(f"slip.{side}", f"stands without slip.{other}", "give both intervals")
    for name in ("measurement_error", "measurement_error_relative"):
        if getattr(slip, name) is not None:
            cure = "give the intervals slip.right and slip.left of the true slips, too"
            refuse(f"slip.{name}", "is of a slip whose interval is not given", cure)
    for side in ("right", "left"):
        largest = abs(getattr(slip, f"nominal_{side}")) * (1 + slip.relative_error)
        if largest >= 1:
            problem = (
                f"with slip.relative_error = {slip.relative_error} the slip reaches {largest:.6g}, "
                "a spinning wheel"
            )
            refuse(f"slip.nominal_{side}", problem, "keep nominal * (1 + relative_error) below 1")


def _check_cost(controller: ControllerTable, refuse: Refuse) -> None:
    """Refuse a cost of deviations from a gain that does not go on when the plan has ended."""
    if controller.cost == "deviation" and not controller.tube_has_terminal_gain:
        problem = f'is "deviation", and controller.terminal = "{controller.terminal}"'
        refuse("controller.cost", problem, 'set controller.terminal = "T-A"')


def _check_limits(scenario: Scenario, refuse: Refuse) -> None:
    """Refuse noise and caps of the measured error that leave the error set E."""
    bounds = noise_bounds(scenario)
    bounds[2] = np.rad2deg(bounds[2])
    for name, noise in zip(("longitudinal_m", "lateral_m", "heading_deg"), bounds, strict=True):
        limit = getattr(scenario.constraints, name)
        cap = getattr(scenario.operating, name)
        left = limit - noise
        if noise >= limit:
            problem = f"leaves nothing of constraints.{name} = {limit}"
            refuse(f"noise.{name}", problem, "reduce it or widen the limit")
        if cap is not None and cap > left * (1 + CAP_ROUNDING):
            problem = f"with the noise of {noise:.6g} passes constraints.{name} = {limit}"
            refuse(f"operating.{name}", problem, f"give at most {left:.6g}")


def _check_complete(operating: Operating, refuse: Refuse) -> None:
    """Refuse caps that need others beside them."""
    rules = (
        (INPUT_CAPS, "all three input caps or none"),
        (COUPLING, "both or none, with the three input caps"),
    )
    for names, cure in rules:
        present = [name for name in names if getattr(operating, name) is not None]
        lacks_one = len(present) < len(names) or operating.yaw_rate_deficit_radps is None
        if present and lacks_one:
            refuse(f"operating.{present[0]}", "is not enough alone", f"give {cure}")


def _check_bands(scenario: Scenario, refuse: Refuse) -> None:
    bands = scenario.operating.bands
    if not bands:
        return
    key = "operating.bands"
    controller = scenario.controller
    if controller.has_observer:
        cure = "leave out controller.observer_gain"
        refuse(key, "act on the measured error, not on an estimate", cure)
    ends = [band.below_mps for band in bands]
    starts = [scenario.reference.wheel_speed_min_mps, *ends[:-1]]
    grow = all(start < end for start, end in zip(starts, ends, strict=True))
    fastest = scenario.reference.wheel_speed_max_mps
    if not grow or not starts[-1] < fastest <= ends[-1]:
        cure = "let below_mps grow up to reference.wheel_speed_max_mps"
        refuse(key, f"end at {ends} m/s", cure)
    _check_band_values(bands, refuse)
    if scenario.reference.certified_for == "path":
        refuse(key, "cover a box, not a path", 'set reference.certified_for = "box"')
    is_exact = controller.model == "exact_jacobian"
    if not is_exact or scenario.disturbance.bound != "computed":
        cure = 'set controller.model = "exact_jacobian" and disturbance.bound = "computed"'
        refuse(key, "need a computed bound and the exact Jacobian", cure)
    if not (controller.tube_has_terminal_gain and controller.tube == "sequence"):
        cure = 'set controller.terminal = "T-A" and controller.tube = "sequence"'
        refuse(key, "give tube and terminal set the same gains, by speed", cure)
    if not controller.restart:
        cure = "set controller.restart = true"
        refuse(key, "change the gains along plans that start at the measured error", cure)
    has_caps = scenario.operating.yaw_rate_deficit_radps is not None
    if controller.tracking_gains or has_caps:
        cure = "leave out input caps and controller.tracking_gains"
        refuse(key, "bring their own caps and gains", cure)


def _check_band_values(bands: tuple[BandTable, ...], refuse: Refuse) -> None:
    """Refuse bands that have some of their caps and gains."""
    missing = [band.list_missing() for band in bands]
    is_bare = all(len(names) == len(BandTable.__struct_fields__) - 1 for names in missing)
    lacking = [names[0] for names in missing if names]
    if lacking and not is_bare:
        cure = "give all caps and gains of every band, or of none for `design --optimise` to find"
        refuse("operating.bands", f"lack {lacking[0]}", cure)
    if any(len(band.tracking_gains) not in (0, 3) for band in bands):
        refuse("operating.bands", "have tracking_gains that are not three", "give [k1, k2, k3]")


def _check_gains(controller: ControllerTable, refuse: Refuse) -> None:
    if controller.tracking_gains and len(controller.tracking_gains) != 3:
        refuse("controller.tracking_gains", "are not three", "give [k1, k2, k3]")
    serves_both = controller.tube_has_terminal_gain and controller.tube == "sequence"
    for name in ("tracking_gains", "vertex_gains"):
        if getattr(controller, name) and not serves_both:
            problem = (
                "are tube and terminal gain at once, "
                "which terminal T-A with tube sequence allows alone"
            )
            cure = 'set controller.terminal = "T-A" and controller.tube = "sequence"'
            refuse(f"controller.{name}", problem, cure)


def _check_vertex_gains(scenario: Scenario, refuse: Refuse) -> None:
    controller = scenario.controller
    gains = controller.vertex_gains
    if not gains:
        return
    key = "controller.vertex_gains"
    if [len(gain) for gain in gains] != [INPUT_SIZE * ERROR_SIZE] * 4:
        refuse(key, "are not four gains", "give four rows [k11, k12, k13, k21, k22, k23]")
    if controller.tracking_gains or scenario.operating.bands:
        refuse(key, "stand beside tracking gains or operating.bands", "leave out one of them")
    is_affine = controller.model != "exact_jacobian" and controller.discretisation == "euler"
    if not is_affine and scenario.reference.certified_for == "box":
        problem = "give loops that four vertices cover for a model affine in the wheel speeds alone"
        cure = (
            'set model = "consistent" and discretisation = "euler", '
            'or reference.certified_for = "path"'
        )
        refuse(key, problem, cure)


def _check_actuation(scenario: Scenario, refuse: Refuse) -> None:
    robot = scenario.robot
    for name in ("wheel_lag_s", "command_delay_s"):
        low, high = getattr(robot, name)
        if not low <= high:
            refuse(f"robot.{name}", "has crossed ends", "give [least, greatest]")
    if robot.obeys_at_once:
        return
    low, high = robot.command_delay_s
    dt = scenario.controller.dt_s
    if high - low > dt:
        problem = f"is wider than controller.dt_s = {dt}: a command may overtake the one before it"
        refuse("robot.command_delay_s", problem, "narrow it or lengthen the period")
    if scenario.operating.bands:
        key = "robot.wheel_lag_s" if robot.wheel_lag_s[1] > 0 else "robot.command_delay_s"
        cure = "leave out operating.bands, or set it to [0.0, 0.0]"
        refuse(key, "goes with no gains by speed, which operating.bands asks for", cure)


def _check_acceleration(scenario: Scenario, refuse: Refuse) -> None:
    key = "robot.wheel_acceleration_max_mps2"
    if scenario.robot.wheel_acceleration_max_mps2 is None:
        return
    slip = scenario.slip
    if slip.is_measured or slip.is_learnt or slip.random != "true":
        problem = "goes with no measured slip, whose compensation makes commands jump"
        which = "slip.random" if slip.random != "true" else "the measurement errors of [slip]"
        which = "slip.change_per_s" if slip.is_learnt else which
        refuse(key, problem, f"leave out {which}, or the limit")
    if scenario.operating.bands:
        problem = "is kept with one gain, and operating.bands has several"
        refuse(key, problem, "leave out one of the two")
    if not scenario.controller.restart:
        problem = "is kept by plans that start at the measured error"
        refuse(key, problem, "set controller.restart = true, or leave out the limit")


def _check_weights(controller: ControllerTable, refuse: Refuse) -> None:
    error_key = "controller.error_weight"
    smallest, rounding = _find_smallest(controller.error_weight, ERROR_SIZE, error_key, refuse)
    if smallest < -rounding:
        problem = f"is not positive semidefinite, its smallest eigenvalue is {smallest:.6g}"
        refuse(error_key, problem, "raise its diagonal")
    input_key = "controller.input_weight"
    smallest, rounding = _find_smallest(controller.input_weight, INPUT_SIZE, input_key, refuse)
    if smallest <= rounding:
        problem = f"is not positive definite, its smallest eigenvalue is {smallest:.6g}"
        refuse(input_key, problem, "raise its diagonal")


def _find_smallest(weight: Weight, size: int, key: str, refuse: Refuse) -> tuple[float, float]:
    """Return (smallest eigenvalue, what counts as 0) of a weight that is a symmetric matrix."""
    try:
        matrix = weight_matrix(weight)
    except ValueError:
        matrix = np.empty((0, 0))
    if matrix.shape != (size, size):
        cure = f"give {size} diagonal entries or {size} rows of {size} numbers"
        refuse(key, "has the wrong shape", cure)
    if (matrix != matrix.T).any():
        refuse(key, "is not symmetric", "give a symmetric matrix")
    smallest = float(np.linalg.eigvalsh(matrix)[0])
    rounding = float(EIGENVALUE_ROUNDING * np.abs(matrix).max())
    return smallest, rounding
