"""Whether what a certificate says holds, in floats and by code that its checker does not share: the
project's own plant and model, and linear programs."""

from fractions import Fraction
from itertools import pairwise, product
from types import SimpleNamespace

import numpy as np
from late_oracle import keeps_lateness
from scipy.optimize import linprog

from jaxtube.plant.model import make_model
from sets.robot.disturbance import disturbance_bound
from sets.robot.observer import bound_next_error
from sets.robot.operation import Operation
from sets.robot.plant import Kinematics
from sets.robot.slip_learning import Learning, bound_learnt_slips

WHEELS = ("right", "left")
LOOSER = 0.01
"""Share by which proofs of learnt slips may differ."""

LOOSE = 2e-4
"""Share by which the project's bound of an estimate's error may be above the least one."""
PROGRAM_ROUNDING = 1e-9
"""Of the answers of linear programs, and of W's own vertices."""
PARTS = 3
"""Mean wheel speeds of a band that are tried."""


def to_floats(value):
    """Return JSON with its fractions as floats, and arrays where they are all numbers."""
    if isinstance(value, dict):
        return {name: to_floats(entry) for name, entry in value.items()}
    if isinstance(value, list):
        return [to_floats(entry) for entry in value]
    try:
        return float(Fraction(value))
    except (ValueError, TypeError):
        return value


def holds_in_floats(certificate) -> bool:
    """Return whether no counterexample is found to what a certificate promises."""
    said = to_floats(certificate)
    if "model" in said:
        return _holds_for_model(said)
    model = make_model(
        "exact_jacobian",
        "euler",
        said["period"],
        said["track"],
        np.zeros(2),
        (np.full(2, 0.2), np.full(2, 1.5)),
    )
    checks = (_keeps_limits, _keeps_disturbances, _keeps_sets, _keeps_cost)
    of_bands = product(checks, said["bands"])
    holds = all(check(said, band, model) for check, band in of_bands)
    return holds and _keeps_slips(said) and _keeps_plans(said, model)


def _holds_for_model(said) -> bool:
    """Return the same of a certificate of a linear model alone."""
    nominal = 1 - np.array(said["model"]["turning"])
    ends = (np.full(2, 0.2), np.full(2, 1.5))
    model = make_model("paper", "euler", said["period"], said["track"], nominal, ends)
    return (
        all(
            check(said, band, model)
            for check in (_keeps_limits, _keeps_wheels, _keeps_cost)
            for band in said["bands"]
        )
    ) and _keeps_plans(said, model)


def _keeps_wheels(said, band, model) -> bool:
    """Try the corners of speeds, inputs and slips."""
    first, second = band["inputs"]
    ends = [(each["low"], each["high"]) for each in (first, second)]
    matrix = [[1, each["on_u2"]] for each in (first, second)]
    inputs = np.linalg.solve(matrix, np.array(list(product(*ends))).T)
    asked = np.array([inputs[0] + sign * said["track"] / 2 * inputs[1] for sign in (1, -1)])
    slowest, fastest = said["wheel_speeds"]
    for index, wheel in enumerate(WHEELS):
        seen = [slip for *_, low, high in said["slips"][wheel] for slip in (low, high)]
        for region, slip in product(band["regions"], seen):
            for speed in np.array(_find_box(region))[:, index]:
                wheels = (speed - asked[index]) / (1 - slip)
                within = np.clip(wheels, slowest, fastest)
                if slip >= 1 or np.max(np.abs(wheels - within)) > PROGRAM_ROUNDING:
                    return False
    return True


def _mix(band, name, speeds):
    """Return a gain between those at the corners of its region."""
    for region, gains in zip(band["regions"], band["gains"], strict=True):
        low, high = np.array(_find_box(region))
        if np.all(low <= speeds) and np.all(speeds <= high):
            shares = (speeds - low) / np.where(high > low, high - low, 1.0)
            pairs = [(1 - share, share) for share in shares]
            weights = [a * b for a, b in product(*pairs)]
            return np.tensordot(weights, np.array(gains[name]), axes=1)
    raise ValueError("no region has these speeds")


def _keeps_limits(said, band, model) -> bool:
    most = np.array(band["errors"]) + _read_estimate(said)[1]
    return bool(np.all(most <= np.array(said["constraints"]) + PROGRAM_ROUNDING))


def _read_estimate(said):
    """Return the gain of an estimate and the bound of its error."""
    estimate = said.get("estimate", {"gain": [1.0] * 3, "error": said["noise"]})
    return tuple(estimate["gain"]), np.array(estimate["error"])


def _keeps_disturbances(said, band, model) -> bool:
    """Compare W, the error of an estimate and the wheel limits with what the project's search
    attains."""
    losses = []
    least = []
    most = []
    for wheel in WHEELS:
        ends = [
            (true - seen) / (1 - seen)
            for low, high, *both in said["slips"][wheel]
            for true, seen in product((low, high), both)
        ]
        grips = [1 - seen for _, _, *both in said["slips"][wheel] for seen in both]
        losses.append((min(ends), max(ends)))
        least.append(max(grip * said["wheel_speeds"][0] for grip in grips))
        most.append(min(grip * said["wheel_speeds"][1] for grip in grips))
    if "learning" in said:
        losses = [(-loss, loss) for loss in band["losses"]]
    errors = np.array(band["errors"])
    of_x, of_turn = band["coupling"]
    gain, error = _read_estimate(said)
    operation = Operation(
        errors=np.stack([-errors, errors]),
        inputs=np.array([band["u1"], band["u2"]]).T,
        schedules=np.array([box for region in band["regions"] for box in _list_boxes(region)]),
        wheel_errors=np.array(losses).T,
        noise=np.array(said["noise"]),
        dt=said["period"],
        track_width=said["track"],
        sideslip=said["sideslip"],
        lever_arm=said["lever_arm"],
        coupling=(1 / of_x, 1 / of_turn),
        gain=gain,
        estimate_error=error,
    )
    if "estimate" in said:
        later = bound_next_error(operation, Kinematics()) * (1 - LOOSE)
        if np.any(error < np.maximum(later, said["noise"])):
            return False
    W = band["disturbance"]
    found = disturbance_bound(operation, Kinematics(), tolerance=0.003)
    lever = said["lateness"]["lever"] if "lateness" in said else 0.0
    lean = operation.kick_per_yaw + lever * gain[1] / gain[2]
    lean_gap = abs(W["lean"] - lean) * found.found_yaw
    room = np.array(W["box"]) - found.found_box
    is_wide = W["yaw"] >= found.found_yaw * (1 - PROGRAM_ROUNDING)
    is_wide &= bool(np.all(room >= -PROGRAM_ROUNDING - lean_gap))
    if "lateness" in said:
        is_wide &= keeps_lateness(said, band, operation, losses)
    slowest, fastest = found.ground_speeds
    # The bounds on speeds are tight to a hundredth here; where they fit, speeds do.
    slack = 0.01
    return is_wide and bool(
        np.all(fastest <= np.array(most) + slack) and np.all(slowest >= np.array(least) - slack)
    )


def _keeps_slips(said) -> bool:
    """Compare the losses of slips that are learnt with what the project proves of its observer."""
    if "learning" not in said:
        return True
    last = said["bands"][-1]
    corners = np.concatenate([_find_box(region) for region in last["regions"]])
    learning = said["learning"]
    proved = bound_learnt_slips(
        Learning(
            slips=np.array([said["slips"][wheel][0][:2] for wheel in WHEELS]).T,
            change=learning["change"],
            periods=int(learning["periods"]),
            errors=np.array(last["errors"]),
            noise=np.array(said["noise"]),
            speeds=np.array([learning["speeds"][wheel] for wheel in WHEELS]).T,
            yaw_rate=np.abs(np.diff(corners)).max() / said["track"] + np.abs(last["u2"]).max(),
            reference_speed=corners.max(),
            dt=said["period"],
            track_width=said["track"],
        )
    ).wheel_errors
    losses = np.array([band["losses"] for band in said["bands"]])
    # The project bounds the turn of a period a little more loosely.
    return losses.shape == proved.shape and bool(np.all(losses >= proved * (1 - LOOSER)))


def _find_box(region):
    return (region, region) if len(region) == 2 else ((region[0],) * 2, (region[1],) * 2)


def _list_boxes(region):
    """Return boxes of wheel speeds that lie in a region: all of it, or places on its rim and in its
    middle."""
    low, high = np.array(_find_box(region))
    if len(region) == 2 or np.array_equal(region[:2], region[2:]):
        return [(low, high)]
    places = []
    for mean, side in product(np.linspace(region[2], region[3], PARTS), (-1, 0, 1)):
        half = side * min(mean - region[0], region[1] - mean)
        places.append(np.array([mean + half, mean - half]))
    return [(place, place) for place in places]


def _make_stage(said, band, model, speeds):
    A, B = model.matrices(np.array(speeds))
    if "model" in said:
        K, G = (_mix(band, name, np.array(speeds)) for name in "KG")
        return SimpleNamespace(A=A, B=B, K=K, loop=A + B @ K, end_K=G, end_loop=A + B @ G)
    k1, k2, k3 = band["gains"]
    rate = (speeds[0] - speeds[1]) / said["track"]
    K = np.array([[-k1, -rate, 0], [0, -k2, -k3]])
    loop = A + B @ K
    return SimpleNamespace(A=A, B=B, K=K, loop=loop, end_K=K, end_loop=loop)


def _draw_stages(said, band, model):
    random = np.random.default_rng(0)
    for region in band["regions"]:
        for low, high in _list_boxes(region):
            if np.array_equal(low, high):
                yield _make_stage(said, band, model, low)
                continue
            for share in (*product((0.0, 1.0), repeat=2), *random.random((8, 2))):
                yield _make_stage(said, band, model, low + np.array(share) * (high - low))


def _reach(band, rows):
    """Return the support numbers of W."""
    W = band["disturbance"]
    rows = np.atleast_2d(rows)
    return W["yaw"] * np.abs(rows @ [0, W["lean"], 1]) + np.abs(rows) @ W["box"]


def _support(rows, offsets, direction) -> float:
    free = [(None, None)] * len(direction)
    answer = linprog(-np.asarray(direction), A_ub=rows, b_ub=offsets, bounds=free)
    return np.inf if answer.status == 3 else -answer.fun if answer.status == 0 else -np.inf


def _list_inputs(band):
    if "inputs" in band:
        on_inputs = np.array([[1, each["on_u2"]] for each in band["inputs"]])
        ends = np.array([(each["low"], each["high"]) for each in band["inputs"]])
        return on_inputs, np.zeros((2, 3)), *ends.T
    of_x, of_turn = band["coupling"]
    on_inputs = np.array([[1, 0], [0, 1], [0, of_turn], [0, -of_turn]])
    on_errors = np.array([[0, 0, 0], [0, 0, 0], [of_x, 0, 0], [of_x, 0, 0]])
    lower = np.array([band["u1"][0], band["u2"][0], -1, -1])
    upper = np.array([band["u1"][1], band["u2"][1], 1, 1])
    return on_inputs, on_errors, lower, upper


def _keeps_sets(said, band, model) -> bool:
    if "learning" in said and band["age"] < said["learning"]["periods"]:
        return True  # at the start alone, where plans say what follows
    shape = said["sets"][band["set"]]
    H = np.array(shape["rows"])
    h = np.array(shape["offsets"])
    on_inputs, on_errors, lower, upper = _list_inputs(band)
    for stage in _draw_stages(said, band, model):
        on_both = on_inputs @ stage.K + on_errors
        rows = np.vstack([H @ stage.loop, np.eye(3), -np.eye(3), on_both, -on_both])
        limits = [h - _reach(band, H), band["errors"], band["errors"], upper, -lower]
        for row, limit in zip(rows, np.concatenate(limits), strict=True):
            if _support(H, h, row) > limit + PROGRAM_ROUNDING:
                return False
    return True


def _keeps_plans(said, model) -> bool:
    """Search the plan and w whose successor misses a row of the next QP most."""
    if "plans" not in said:
        return True
    plans = said["plans"]
    windows = plans["windows"]
    bands = {band["name"]: band for band in said["bands"]}
    for now, after in set(pairwise(int(index) for index in plans["sequence"])):
        rows, offsets = _list_halfspaces(windows[now], plans["tolerance"])
        band = bands[windows[now]["bands"][0]]
        next_band = bands[windows[after]["bands"][0]]
        caps = np.eye(rows.shape[1])[:3]
        rows = np.vstack([rows, caps, -caps])
        offsets = np.concatenate([offsets, np.tile(band["errors"], 2)])
        plan, disturbed = _succeed(said, bands, model, windows[now], windows[after])
        wanted, limits = _list_halfspaces(windows[after], 0.0)
        wanted = np.vstack([wanted, caps, -caps])
        limits = np.concatenate([limits, np.tile(next_band["errors"], 2)])
        reached = _reach(band, wanted @ disturbed)
        for row, limit, by_w in zip(wanted @ plan, limits, reached, strict=True):
            if _support(rows, offsets, row) + by_w > limit + PROGRAM_ROUNDING:
                return False
    return True


def _list_halfspaces(window, tolerance):
    """Return rows and offsets on (e_0, g_0, ..) of the plans that a QP accepts."""
    norms = np.array(window["norms"])
    rows = np.array(window["rows"])
    rows[:, 3:] *= norms[:, None]
    lower = np.array([-np.inf if end is None else end for end in window["lower"]])
    upper = np.array([np.inf if end is None else end for end in window["upper"]])
    offsets = np.concatenate([upper, -lower]) + np.tile(norms, 2) * tolerance
    kept = np.isfinite(offsets)
    return np.vstack([rows, -rows])[kept], offsets[kept]


def _succeed(said, bands, model, window, following):
    """Return the matrices by which (e_0, g_0, ..) and w give the next error and plan."""
    named = zip(window["bands"], window["speeds"], strict=True)
    stages = [_make_stage(said, bands[name], model, speeds) for name, speeds in named]
    last = _make_stage(said, bands[following["bands"][-1]], model, following["speeds"][-1])
    N = len(stages)
    unit = np.eye(3 + 2 * N)
    errors = [unit[:3]]
    for j, stage in enumerate(stages):
        inputs = unit[3 + 2 * j : 5 + 2 * j]
        errors.append(stage.A @ errors[-1] + stage.B @ inputs)
    of_plan = [errors[1]]
    of_w = [np.eye(3)]
    deviation = np.eye(3)
    for j in range(1, N):
        of_plan.append(unit[3 + 2 * j : 5 + 2 * j])
        of_w.append(stages[j].K @ deviation)
        deviation = stages[j].loop @ deviation
    of_plan.append(last.end_K @ errors[N])
    of_w.append(last.end_K @ deviation)
    return np.vstack(of_plan), np.vstack(of_w)


def _keeps_cost(said, band, model) -> bool:
    if "cost" not in said:
        return True
    P, Q, R = (np.array(said["cost"][name]) for name in "PQR")
    return all(
        np.linalg.eigvalsh(_find_decrease(stage, P, R) - Q).min() >= -PROGRAM_ROUNDING
        for stage in _draw_stages(said, band, model)
    )


def _find_decrease(stage, P, R):
    end_K = stage.end_K
    return P - stage.end_loop.T @ P @ stage.end_loop - end_K.T @ R @ end_K
