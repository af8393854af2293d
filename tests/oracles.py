"""Independent oracles of the closed-loop tests, in plain numpy: model, gains, the MPC's QP, and
exact solvers for it.

Nothing here uses the condensed matrices of the design, nor the batched solver. The QP is built by
simulating unit vectors step by step and solved by DAQP, an exact dual active-set method; whether it
has a solution is a linear program.
"""

import daqp
import numpy as np
from scipy.linalg import expm
from scipy.optimize import linprog
from tolerances import KKT

REACHED = 1e-12  # coefficients below it are those of a row that no input reaches

# Overrides that make designs of other kinds: the tube along the reference with the terminal gain in
# it; wheels too slow for any terminal set, so that a plan that starts near the edge holds many
# rows.
SEQUENCE = (
    "controller.terminal=T-A",
    "controller.tube=sequence",
    "reference.wheel_speed_min_mps=1.0",
)
TIGHT = ("robot.wheel_speed_max_mps=2.2", "robot.wheel_speed_min_mps=0.5")


def yaw_rate(problem, wheels):
    """Return the yaw rate of the prediction model at reference wheel speeds (right, left)."""
    slip = problem.scenario.slip
    right = 1 - slip.nominal_right
    left = 1 - slip.nominal_left
    if problem.scenario.controller.model == "consistent":
        right = left = 1.0
    return (right * wheels[0] - left * wheels[1]) / problem.scenario.robot.track_width_m


def model(problem, wheels):
    """Return A and B of the prediction model at reference wheel speeds (right, left)."""
    settings = problem.scenario.controller
    rates = np.zeros((5, 5))
    rates[0, 1] = yaw_rate(problem, wheels)
    rates[1, 0] = -rates[0, 1]
    rates[1, 2] = (wheels[0] + wheels[1]) / 2
    rates[0, 3] = rates[2, 4] = 1
    step = settings.dt_s * rates
    step = expm(step) if settings.discretisation == "zoh" else np.eye(5) + step
    return step[:3, :3], step[:3, 3:]


def terminal_gain(design, wheels):
    """Return Gamma(th): bilinear in the wheel speeds between (min, max), (min, min), (max, min),
    (max, max)."""
    reference = design.problem.scenario.reference
    width = reference.wheel_speed_max_mps - reference.wheel_speed_min_mps
    right, left = (np.asarray(wheels) - reference.wheel_speed_min_mps) / width
    shares = [(1 - right) * left, (1 - right) * (1 - left), right * (1 - left), right * left]
    return sum(
        share * gain for share, gain in zip(shares, design.terminal.gains.vertices, strict=True)
    )


def tube_gain(design, wheels):
    """Return K(th): for T-A the terminal gain, else K^n + K^r dV_r + K^l dV_l, which cancels the
    first rows of A."""
    problem = design.problem
    if problem.scenario.controller.terminal == "T-A":
        return terminal_gain(design, wheels)
    reference = problem.scenario.reference
    centre = np.full(2, (reference.wheel_speed_min_mps + reference.wheel_speed_max_mps) / 2)
    gain = np.array(design.lqr_gain)
    gain[0, 1] -= yaw_rate(problem, wheels) - yaw_rate(problem, centre)
    return gain


def simulate_model(problem, schedule, error, inputs):
    """Return e_0 .. e_N of the prediction model."""
    errors = [np.asarray(error, float)]
    for wheels, step_input in zip(schedule, inputs, strict=True):
        A, B = model(problem, wheels)
        errors.append(A @ errors[-1] + B @ step_input)
    return np.array(errors)


class PlainQp:
    """The QP of one step along the reference: minimise 1/2 g'Hg + (Fe)'g subject to G g <= h - S e,
    one-sided rows."""

    def __init__(self, design, step, with_tube=True):
        problem = design.problem
        window = design.windows.index[step]
        self.horizon = N = problem.horizon
        schedule = problem.schedule[step : step + N]
        units = np.eye(3 + 2 * N)
        # Column by column: the error at every stage that one unit of start or input causes.
        plans = [
            simulate_model(problem, schedule, unit[:3], unit[3:].reshape(N, 2)) for unit in units
        ]
        self.predictions = np.moveaxis(plans, 0, -1)
        inputs = np.concatenate([np.zeros((2 * N, 3)), np.eye(2 * N)], axis=1).reshape(N, 2, -1)
        weights = [problem.error_weight] * N + [design.cost.cost]
        cost = sum(
            2 * stage.T @ Q @ stage for Q, stage in zip(weights, self.predictions, strict=True)
        )
        cost = cost + sum(2 * stage.T @ problem.input_weight @ stage for stage in inputs)
        # DAQP reads a matrix as it lies in memory, whatever its strides.
        self.hessian = np.ascontiguousarray(cost[3:, 3:])
        self.linear = cost[3:, :3]
        E = problem.error_set.normals
        U = problem.input_set.normals
        rows = [E @ stage for stage in self.predictions[1:N]] + [U @ stage for stage in inputs]
        if with_tube:
            offsets = [
                *design.bounds.errors[window, 1:],
                *design.bounds.inputs[window],
                design.bounds.terminal[window],
            ]
            rows.append(design.bounds.terminal_normals @ self.predictions[N])
        else:
            offsets = [problem.error_set.offsets] * (N - 1) + [problem.input_set.offsets] * N
        rows = np.concatenate(rows)
        self.rows = rows[:, 3:]
        self.row_errors = rows[:, :3]
        self.offsets = np.concatenate(offsets)
        self.reached = np.abs(self.rows).max(axis=1) > REACHED

    def limits(self, error):
        """Return the bounds on G g from one error."""
        return self.offsets - self.row_errors @ error

    def solve(self, error):
        """Return (g, multipliers) by DAQP, or None where no g meets the rows."""
        limits = self.limits(error)
        if np.any(limits[~self.reached] < -KKT):
            return None
        G = np.ascontiguousarray(self.rows[self.reached])
        h = limits[self.reached]
        answer, _, flag, info = daqp.solve(
            self.hessian,
            self.linear @ error,
            G,
            h,
            np.full(len(h), -1e30),
            primal_tol=1e-11,
            dual_tol=1e-12,
        )
        return (np.array(answer), np.array(info["lam"])) if flag == 1 else None

    def shortfall(self, error):
        """Return by how much the rows must give way before there is a plan, at most 0 if there is
        one."""
        columns = np.column_stack([self.rows, -np.ones(len(self.rows))])
        cost = np.eye(columns.shape[1])[-1]
        answer = linprog(
            cost,
            columns,
            self.limits(error),
            bounds=[(None, None)] * (len(cost) - 1) + [(-1, None)],
        )
        assert answer.status == 0
        return answer.fun

    def plan(self, error):
        """Return the inputs (N, 2) and errors e_0 .. e_N of the best plan, or None."""
        answer = self.solve(error)
        if answer is None:
            return None
        inputs = answer[0]
        return inputs.reshape(-1, 2), self.predictions @ np.concatenate([error, inputs])


class PlainMpc:
    """The QPs along the reference, one for each distinct stretch, built when it is first met."""

    def __init__(self, design, with_tube=True):
        self.design = design
        self.with_tube = with_tube
        self.found = {}

    def qp(self, step):
        """Return the QP of one step."""
        ahead = self.design.problem.schedule[step : step + self.design.problem.horizon]
        key = ahead.round(9).tobytes()
        if key not in self.found:
            self.found[key] = PlainQp(self.design, step, self.with_tube)
        return self.found[key]
