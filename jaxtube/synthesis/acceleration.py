"""Rows that keep the acceleration of the wheels, without the last command as a state of the plan.

With a fixed gain K and q = u - K e every loop obeys

    u(k+1) - u(k) = q(k+1) + [K (A e + B u) - u](k) + K w(k),

so that of m = (1, l) and (1, -l), l the outermost lever of the turns (`sets.robot.command_steps`),

    |m u - m K e| <= kept,    |m K (A e + B u) - m u| <= left,    kept + left + h_W(m K) <= change

bound how far m u changes in a period by `change`: what a wheel may change its command by, less the
step of the reference and what the input map adds. The rows hold for A and B at the middle of the
certified wheel speeds; what these vary by over errors and inputs is part of the sum.

Any K will do. That of the law itself turns with the reference, which fixed rows cannot follow; the
one chosen lets the law need least. Both rows take what the law needs along its own tube, and half
of what is over each.

Source: new.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize

from jaxtube.scenario.refusal import ScenarioError
from jaxtube.synthesis.gains import Gain
from jaxtube.synthesis.limits import (
    FirstCommand,
    InputRows,
    find_command_step,
    make_input_rows,
)
from jaxtube.synthesis.problem import Problem
from jaxtube.synthesis.terminal_cost import terminal_cost_and_gain
from sets.robot.command_steps import (
    OUTWARDS,
    MapSlopes,
    ModelRange,
    bound_error_steps,
    bound_map_slopes,
    bound_mapped_steps,
    enclose_model,
)
from sets.robot.operation import Operation
from sets.robot.plant import Kinematics

TUBE_STEPS = 100
"""Periods after which a tube has all but settled."""
ACCURACY = {"xatol": 1e-4, "fatol": 1e-6, "maxiter": 600}
"""Of m K and of what it needs."""
DIGITS = 3
"""Decimals of m K: more would differ from one processor to another."""


@dataclass(frozen=True, eq=False)
class StepBounds:
    """What of a command's change is not the plan's.

    Attributes:
        commands: greatest change of the wheels (right, left), m/s over ground.
        reference: greatest change of the reference's wheels, m/s.
        mapped: what the input map adds, m/s.
        lever: l, m.
        slopes: of the input map.
        model: where A and B lie.
    """

    commands: Float[np.ndarray, "2"]
    reference: Float[np.ndarray, "2"]
    mapped: float
    lever: float
    slopes: MapSlopes
    model: ModelRange

    @property
    def rows(self) -> Float[np.ndarray, "2 2"]:
        """Rows m on the inputs."""
        return np.array([[1.0, self.lever], [1.0, -self.lever]])

    @property
    def change(self) -> float:
        """What is left of the change of m u, m/s; both wheels may take either row."""
        return float(np.min(self.commands - OUTWARDS * (self.reference + self.mapped)))


def find_command_steps(problem: Problem) -> Float[np.ndarray, "2"] | None:
    """Return the greatest change of what the wheels (right, left) are told in a period, m/s over
    ground under the slip that is compensated; None for no limit."""
    most = find_command_step(problem.scenario)
    return None if most is None else most * (1 - np.array(problem.scenario.slip.nominal))


def find_reference_steps(problem: Problem) -> Float[np.ndarray, "2"]:
    """Return the greatest change of the reference's wheels (right, left) in a period, m/s."""
    return np.max(np.abs(np.diff(problem.schedule, axis=0)), axis=0, initial=0.0)


def bound_steps(problem: Problem, where: Operation, how: Kinematics) -> StepBounds:
    """Bound what of a command's change is not the plan's, over an operation.

    Raises:
        ValueError: where an angle may leave a quarter turn.
    """
    commands = find_command_steps(problem)
    assert commands is not None
    slopes = bound_map_slopes(where, how)
    model = enclose_model(where, how)
    reference = find_reference_steps(problem)
    moved = bound_error_steps(where, model, problem.disturbance_set.support(np.eye(3)))
    return StepBounds(
        commands=commands,
        reference=reference,
        mapped=bound_mapped_steps(slopes, where, moved, reference),
        lever=problem.model.track_width / 2 + float(slopes.inputs[1]),
        slopes=slopes,
        model=model,
    )


class _Law:
    """What the terminal law needs of the two rows that stand for one m, by the m K that is chosen.

    Args:
        problem: whose W is known.
        gain: of the law.
        row: m.
        model: where A and B lie.
        largest: half widths of errors and inputs.
    """

    def __init__(
        self,
        problem: Problem,
        gain: Gain,
        row: Float[np.ndarray, "2"],
        model: ModelRange,
        largest: Float[np.ndarray, "5"],
    ):
        self.row = row
        self.model = model
        self.largest = largest
        self.corners = problem.disturbance_set.vertices().T
        loops, self.gains = gain.pairs
        powers = [np.broadcast_to(np.eye(3), loops.shape)]
        for _ in range(TUBE_STEPS):
            powers.append(loops @ powers[-1])
        self.reached = np.stack(powers, axis=1) @ self.corners

    def rows(self, on_error: Float[np.ndarray, "3"]) -> InputRows:
        """Return the rows of m u - m K e and m K (A e + B u) - m u, without offsets."""
        predicted = on_error @ self.model.middle
        inputs = np.stack([self.row, predicted[3:] - self.row])
        return InputRows(inputs, np.stack([-on_error, predicted[:3]]), np.zeros(2))

    def use(self, on_error: Float[np.ndarray, "3"]) -> Float[np.ndarray, "2"]:
        """Return how far the two rows reach along the tube of each loop and its gain."""
        directions = self.rows(on_error).on_errors(self.gains)[:, None]
        return (directions @ self.reached).max(axis=-1).sum(axis=1).max(axis=0)

    def unknown(self, on_error: Float[np.ndarray, "3"]) -> float:
        """Return what m K makes of a disturbance and of what the model varies by."""
        of_model = np.abs(on_error) @ self.model.radius @ self.largest
        return float(OUTWARDS * (np.max(on_error @ self.corners) + of_model))

    def total(self, on_error: Float[np.ndarray, "3"]) -> float:
        """Return what the law needs in all, m/s: convex in m K."""
        return float(self.use(on_error).sum() + self.unknown(on_error))

    def choose(self) -> Float[np.ndarray, "3"]:
        """Return an m K that needs little: not the law's own, which turns with the reference."""
        own = self.row @ self.gains.mean(axis=0)
        starts = [own, np.array([0.0, *own[1:]])]
        found = [
            minimize(self.total, start, method="Nelder-Mead", options=ACCURACY) for start in starts
        ]
        best = min(found, key=lambda each: each.fun).x
        return np.round(best, DIGITS)


def limit_acceleration(problem: Problem, where: Operation, how: Kinematics) -> Problem:
    """Return the problem with the rows that keep the acceleration of the wheels.

    Raises:
        ScenarioError: where the law alone would need more, with the least limit that leaves it
            enough; where the operation is so wide that angles leave a quarter turn, or there is no
            law.
    """
    try:
        bounds = bound_steps(problem, where, how)
        _, gain = terminal_cost_and_gain(problem)
    except (RuntimeError, ValueError) as error:
        raise ScenarioError(f"scenario: robot.wheel_acceleration_max_mps2: {error}") from None
    largest = np.abs(where.box[:, :5]).max(axis=0)
    feedback = []
    pairs = []
    for row in bounds.rows:
        law = _Law(problem, gain, row, bounds.model, largest)
        on_error = law.choose()
        feedback.append(on_error)
        used = law.use(on_error)
        over = bounds.change - law.unknown(on_error) - used.sum()
        if over <= 0:
            raise _refuse_limit(problem, bounds, law.total(on_error))
        pairs.append(replace(law.rows(on_error), offsets=used + over / 2))
    first, second = pairs
    first_command = FirstCommand(
        feedback=np.stack(feedback),
        kept=np.array([first.offsets[0], second.offsets[0]]),
        map_slopes=bounds.slopes.errors,
        mapped=float(bounds.slopes.inputs[0] * largest[3]),
        most=float(bounds.commands.min()),
    )
    rows = make_input_rows(problem.scenario, problem.input_set)
    return replace(
        problem,
        input_rows=rows.with_pairs(first).with_pairs(second),
        first_command=first_command,
    )


def _refuse_limit(problem: Problem, bounds: StepBounds, used: float) -> ScenarioError:
    """Return the refusal of a limit that the law alone would pass, with the least that it needs."""
    most = problem.scenario.robot.wheel_acceleration_max_mps2
    assert most is not None
    needed = used + bounds.reference + bounds.mapped
    least = np.max(needed / bounds.commands) * most
    dt = problem.model.dt
    parts = {
        "steps of the reference": float(bounds.reference.max()),
        "the law along its tube": used,
        "the input map": bounds.mapped,
    }
    listed = ", ".join(f"{size / dt:.3g} for {name}" for name, size in parts.items())
    return ScenarioError(
        f"scenario: robot.wheel_acceleration_max_mps2 = {most:g}: over ground {listed} may be "
        f"needed (m/s^2); raise it by a few per cent above {least:.4g}, or lower gains, caps, "
        "reference.speed_mps or the disturbances"
    )
