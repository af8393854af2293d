"""What of a design goes into `certificate.json`, as fractions: robot, bands, sets, cost and QPs.

Source: new.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxtube import qp
from jaxtube.plant.slip_bounds import slip_bounds
from jaxtube.scenario.error_box import bound_pose_noise, error_vector
from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.bands import list_ends
from jaxtube.synthesis.certificate.program import predict_rows
from jaxtube.synthesis.disturbance import (
    find_actuation,
    find_place,
    find_wheel_error_sizes,
    kinematics,
)
from jaxtube.synthesis.learnt_slips import count_learnt_periods, make_slip_observer
from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.prediction import UNREACHED
from jaxtube.synthesis.problem import Problem
from sets.robot.driving import find_driving

BAND = "band {}"
SET = "invariant set"
LEVEL = 1e-12
"""Share of a bound by which those of the two wheels may differ by rounding."""
SPEED_ROOM = 1e-6
"""Share of a ground speed by which what is asked of wheels that learn may be passed."""


def list_fractions(values: Any) -> list:
    """Return numbers, in lists as they were, as the fractions they are; None for infinite ones."""
    return [list_fractions(each) if np.ndim(each) else _read_fraction(each) for each in values]


def _read_fraction(value: float) -> Fraction | None:
    return Fraction(float(value)) if np.isfinite(value) else None


def describe_robot(problem: Problem) -> dict[str, Any]:
    scenario = problem.scenario
    robot = problem.robot
    errors = [scenario.slip.measurement_error, scenario.slip.measurement_error_relative]
    within = [Fraction(error or 0.0) for error in errors]
    measured = {"measured": {"right": within, "left": within}} if scenario.slip.is_measured else {}
    return {
        **measured,
        **_describe_estimate(problem),
        **_describe_lateness(problem),
        "period": Fraction(problem.model.dt),
        "track": Fraction(problem.model.track_width),
        "lever_arm": Fraction(robot.lever_arm),
        "wheel_speeds": list_fractions([robot.wheel_speed_min, robot.wheel_speed_max]),
        "constraints": list_fractions(error_vector(scenario.constraints)),
        "noise": list_fractions(problem.noise),
        "sideslip": Fraction(scenario.slip.sideslip),
        "slips": {
            wheel: _list_slips(scenario, index) for index, wheel in enumerate(("right", "left"))
        },
    }


def _describe_estimate(problem: Problem) -> dict[str, Any]:
    """Return the gain of an observer and the greatest error of its estimate; nothing where the
    controller acts on what is measured."""
    settings = problem.scenario.controller
    if not settings.has_observer:
        return {}
    gain = list_fractions(settings.observer_gain)
    return {"estimate": {"gain": gain, "error": list_fractions(problem.estimate_error)}}


def _describe_lateness(problem: Problem) -> dict[str, Any]:
    """Return lag and delay, what noise of the pose is, and what may be commanded; nothing where
    wheels obey at once."""
    scenario = problem.scenario
    if scenario.robot.obeys_at_once:
        return {}
    actuation = find_actuation(scenario)
    nominal = actuation.nominal(problem.model.dt)
    place = find_place(problem)
    driving = find_driving(place, kinematics(problem))
    slowest = _level_wheels(-driving.wheels[0])
    fastest = _level_wheels(driving.wheels[1])
    wheels = np.stack([-slowest, fastest], axis=1)
    return {
        "lateness": {
            "lag": list_fractions(actuation.lag),
            "delay": list_fractions(actuation.delay),
            "nominal": list_fractions(nominal),
            "lever": Fraction(nominal.latency * 2 * place.period.lateral_per_yaw / place.dt),
            "noise": list_fractions(bound_pose_noise(scenario)),
            "wheels": dict(zip(("right", "left"), list_fractions(wheels), strict=True)),
            "speeds": list_fractions(driving.speed),
        }
    }


def _list_slips(scenario: Scenario, wheel: int) -> list[list[Fraction]]:
    """Return (least, greatest) true slips of a wheel, with those that are compensated.

    What is read as either may change with the command. Of wheels that lag it is the true one.
    """
    slip = scenario.slip
    if slip.has_intervals:
        bounds = slip_bounds(slip)
        ends = (slip.right, slip.left)[wheel]
        assert ends is not None
        if slip.is_learnt or slip.is_measured:
            return [[*map(Fraction, ends), *map(Fraction, ends)]]
        nominal = Fraction(float(bounds.nominal[wheel]))
        return [[*map(Fraction, ends), nominal, nominal]]
    nominal = Fraction(slip.nominal[wheel])
    ends = sorted(nominal * (1 + sign * Fraction(slip.relative_error)) for sign in (-1, 1))
    if slip.random == "both":
        return [[*ends, *ends]]
    true = [*ends, nominal, nominal]
    measured = [nominal, nominal, *ends]
    if scenario.robot.obeys_at_once:
        return [true, measured]
    return [measured if slip.random == "measured" else true]


def _describe_learning(problem: Problem) -> dict[str, Any]:
    """Return what slips are learnt from, and the ground speeds (least, greatest) of each wheel."""
    observer = make_slip_observer(problem)
    slowest, fastest = find_driving(find_place(problem), kinematics(problem)).wheels
    slowest = _level_wheels(-slowest * (1 - SPEED_ROOM))
    fastest = _level_wheels(fastest * (1 + SPEED_ROOM))
    speeds = np.stack([-slowest, fastest], axis=1)
    return {
        "change": Fraction(observer.change),
        "periods": Fraction(observer.periods),
        "speeds": dict(zip(("right", "left"), list_fractions(speeds), strict=True)),
    }


def _level_wheels(bounds: Float[np.ndarray, "2"]) -> Float[np.ndarray, "2"]:
    """Return upper bounds by wheel (right, left), the same where they differ by rounding: what
    turns right is then the mirror image of what turns left."""
    return np.full(2, bounds.max()) if np.ptp(bounds) < LEVEL * np.abs(bounds).max() else bounds


def _describe_band(problem: Problem, name: str, regions: list) -> dict[str, Any]:
    """Return caps, gains and W of a band, in which the whole of each of the regions lies."""
    rows = problem.input_rows
    half = len(rows.offsets) // 2
    coupled = np.flatnonzero(rows.is_coupled)
    coupling = [0.0, 0.0]
    if len(coupled):
        coupling = [rows.errors[coupled[0], 0], abs(rows.inputs[coupled[0], 1])]
    bound = problem.disturbance_bound
    assert bound is not None
    return {
        "name": name,
        "regions": regions,
        "errors": list_fractions(problem.operating_set.offsets[:3]),
        "u1": list_fractions([-rows.offsets[half], rows.offsets[0]]),
        "u2": list_fractions([-rows.offsets[half + 1], rows.offsets[1]]),
        "coupling": list_fractions(coupling),
        "disturbance": {
            "yaw": Fraction(bound.yaw),
            "lean": Fraction(bound.lateral_per_yaw),
            "box": list_fractions(bound.box),
        },
        **_describe_age(problem),
    }


def _describe_age(problem: Problem) -> dict[str, Any]:
    """Return how many periods slips have been learnt in a regime, and how far ground speeds may
    be off; nothing where no slip is learnt."""
    if not problem.scenario.slip.is_learnt:
        return {}
    age = problem.periods_learnt
    lasting = count_learnt_periods(problem.scenario)
    losses = _level_wheels(find_wheel_error_sizes(problem))
    return {
        "age": Fraction(lasting if age is None else age),
        "losses": list_fractions(losses),
    }


def _describe_set(polytope: Any) -> dict[str, Any]:
    rows = list_fractions(polytope.normals)
    return {SET: {"rows": rows, "offsets": list_fractions(polytope.offsets)}}


def _describe_cost(design: Design) -> dict[str, list]:
    problem = design.problem
    cost = {"P": design.cost.cost, "Q": problem.error_weight, "R": problem.input_weight}
    return {name: list_fractions(matrix) for name, matrix in cost.items()}


def _describe_law(problem: Problem) -> dict[str, Any]:
    gains = list_fractions(problem.scenario.controller.tracking_gains)
    return {"gains": gains, "set": SET}


def describe_mixed(design: Design) -> dict[str, Any]:
    """Return a linear model whose gains are mixed, its band, its cost and its QPs."""
    problem = design.problem
    (regions,) = _list_regions(problem)
    describe = _describe_band if problem.has_computed_bound else _describe_assumed
    corners = [
        [[right, left] for right in (lower[0], upper[0]) for left in (lower[1], upper[1])]
        for lower, upper in problem.regions
    ]
    laws = {"K": design.tube_gain, "G": design.terminal.gains}
    gains = [
        {name: list_fractions(gain.along(np.array(each))) for name, gain in laws.items()}
        for each in corners
    ]
    return {
        "model": {"turning": list_fractions(problem.model.slip_factors)},
        "bands": [{**describe(problem, BAND.format(1), regions), "gains": gains}],
        "cost": _describe_cost(design),
        "plans": _describe_plans(design),
    }


def _describe_assumed(problem: Problem, name: str, regions: list) -> dict[str, Any]:
    """Return caps, inputs that wheels can do and a W that is assumed."""
    return {
        "name": name,
        "regions": regions,
        "errors": list_fractions(problem.operating_set.offsets[:3]),
        "inputs": _list_deficits(problem),
        "disturbance": {
            "yaw": Fraction(0),
            "lean": Fraction(0),
            "box": list_fractions(problem.disturbance_set.support(np.eye(3))),
        },
    }


def _list_deficits(problem: Problem) -> list[dict[str, Fraction]]:
    """Return the rows on u1 + (b/2) u2 and u1 - (b/2) u2 that wheels can do."""
    rows = problem.input_rows
    return [
        {
            "on_u2": Fraction(rows.inputs[index, 1]),
            "low": -Fraction(rows.offsets[2 + index]),
            "high": Fraction(rows.offsets[index]),
        }
        for index in (0, 1)
    ]


def describe_design(design: Design) -> dict[str, Any]:
    """Return the bands of a design, its terminal set, its cost and its QPs."""
    problem = design.problem
    regions = _list_regions(problem)
    bands = [
        {**_describe_band(regime, BAND.format(number), of_band), **_describe_law(regime)}
        for number, (regime, of_band) in enumerate(
            zip(problem.every_regime, regions, strict=True), start=1
        )
    ]
    learning = {"learning": _describe_learning(problem)} if problem.scenario.slip.is_learnt else {}
    return {
        **learning,
        "bands": bands,
        "sets": _describe_set(design.terminal.invariant),
        "cost": _describe_cost(design),
        "plans": _describe_plans(design),
    }


def _list_regions(problem: Problem) -> list[list]:
    """Return the regions of every band: of several bands one each, by the mean of wheel speeds."""
    if problem.scenario.operating.bands:
        low, high = problem.model.box
        _, *ends, _ = list_ends(problem.scenario)
        # Means that round to the end of a band belong to it.
        slowest = [low[0], *ends]
        fastest = [*np.nextafter(ends, np.inf), high[0]]
        means = zip(slowest, fastest, strict=True)
        return [[list_fractions([low[0], high[0], *of_band])] for of_band in means]
    regions = []
    for lower, upper in problem.regions:
        is_pair = np.array_equal(lower, upper)
        ends = lower if is_pair else [lower[0], upper[0], lower[0], upper[0]]
        regions.append(list_fractions(ends))
    return [regions] * len(problem.every_regime)


def _describe_plans(design: Design) -> dict[str, Any]:
    """Return the rows of the QPs as they run, which row is which, and the order of windows."""
    problem = design.problem
    qps = design.tube_qps
    largest = float(np.max(problem.input_set.support(np.concatenate([np.eye(2), -np.eye(2)]))))
    windows = []
    for index, speeds in enumerate(design.windows.schedules):
        running = np.hstack([qps.row_errors[index], qps.factors.rows[index]])
        checks = qps.check_errors[index]
        padded = np.hstack([checks, np.zeros((len(checks), running.shape[1] - 3))])
        norms = np.concatenate([qps.factors.row_norms[index], np.ones(len(checks))])
        lower = np.concatenate([qps.lower[index], qps.check_lower[index]])
        upper = np.concatenate([qps.upper[index], qps.check_upper[index]])
        parts = {"speeds": speeds, "rows": np.vstack([running, padded]), "norms": norms}
        parts |= {"lower": lower, "upper": upper}
        bands = [BAND.format(regime + 1) for regime in design.windows.regimes[index]]
        described = {name: list_fractions(part) for name, part in parts.items()}
        windows.append({"bands": bands, **described})
    return {
        "tolerance": Fraction(qp.bound_tolerance(largest)),
        "terminal": {"rows": list_fractions(design.bounds.terminal_normals)},
        "order": _list_rows(design),
        "windows": windows,
        "sequence": design.windows.index.tolist(),
    }


def _list_rows(design: Design) -> list[list]:
    """Return (kind, stage, number) of the QPs' rows, those that no input reaches at the end."""
    N = design.problem.horizon
    half = design.problem.input_row_count // 2
    rows = [["errors", stage, i] for stage in range(1, N) for i in range(3)]
    rows += [["inputs", stage, i] for stage in range(N) for i in range(half)]
    rows += [["terminal", N, i] for i in range(len(design.bounds.terminal_normals))]
    reached = np.abs(predict_rows(design)[:, :, 3:]).max(axis=(0, 2)) > UNREACHED
    return [rows[i] for i in (*np.flatnonzero(reached), *np.flatnonzero(~reached))]
