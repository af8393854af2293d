"""The numbers of an exported controller: the condensed QPs of every window, what tracks the pose,
and the limits that its inputs are judged by.

Rows have unit norm, as in the solver, and those that no input reaches are rows like the others,
zero on the inputs. Opposite rows are one row with two bounds.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float, Int

from jaxtube import qp
from jaxtube.control.planning import CondensedQp
from jaxtube.plant.forecast import Forecast
from jaxtube.plant.slip_bounds import compensated_slips, slip_bounds
from jaxtube.synthesis.disturbance import find_actuation
from jaxtube.synthesis.parts import Design

TIMING = 0.1
"""Share of a period by which poses may be old and calls early or late, and still be used."""
CERTIFIED_TIMING = 1e-6
"""The same for what is guaranteed: certificates know no such times."""
WIDER = 2
"""Times their caps that errors and inputs of plans are taken to be in proofs."""
EXCHANGES = 4
"""By the number of inputs of a plan, before the active rows are given up."""
SLIP_ROUNDING = 1e-12
"""By which a measured slip may leave its interval."""


@dataclass(frozen=True)
class Precision:
    """Numbers of one length, and the tolerances of the active-set method in it.

    Attributes:
        name: of the numpy dtype of the QPs' constants.
        tolerance: by which a plan may miss a row of unit norm.
        row_tolerance: by which the method may leave a row missed.
        dependent: share of a normal's square below which what active rows leave of it counts as
            zero.
        unmoved: below which the change of a multiplier counts as zero.
    """

    name: str
    tolerance: float
    row_tolerance: float
    dependent: float
    unmoved: float

    @property
    def epsilon(self) -> float:
        """The relative distance of neighbouring numbers."""
        return float(np.finfo(self.name).eps)


DOUBLE = Precision("float64", qp.TOLERANCE[8], 1e-11, 2.0**-33, 2.0**-39)
SINGLE = Precision("float32", 5e-6, 1e-6, 2.0**-14, 2.0**-17)


@dataclass(frozen=True, eq=False)
class Constants:
    """All numbers of an exported controller. Wheels and slips are (right, left), errors
    (longitudinal m, lateral m, heading rad); what follows a window has a leading axis over them.

    `rows` to `start` are those of the QPs, in the precision they are solved in:

        plan x meets   lower <= row_errors e + rows x <= upper
        without a row  x = free_inputs e;     in coordinates z of round cost, x = unwhiten z
        rows on z are  whitened,   and z without a row is start e
    """

    rows: Float[np.ndarray, "windows m n"]
    row_errors: Float[np.ndarray, "windows m 3"]
    lower: Float[np.ndarray, "windows m"]
    upper: Float[np.ndarray, "windows m"]
    whitened: Float[np.ndarray, "windows m n"]
    unwhiten: Float[np.ndarray, "windows n n"]
    free_inputs: Float[np.ndarray, "windows n 3"]
    start: Float[np.ndarray, "windows n 3"]
    tube_gain: Float[np.ndarray, "windows 2 3"]
    terminal_gain: Float[np.ndarray, "windows 2 3"]
    transition: Float[np.ndarray, "windows 3 3"]
    input_matrix: Float[np.ndarray, "windows 3 2"]
    window: Int[np.ndarray, " steps"]
    reference_wheels: Float[np.ndarray, "steps+1 2"]  # m/s
    reference_poses: Float[np.ndarray, "steps+1 3"]  # (x m, y m, heading rad) in the world
    caps: Float[np.ndarray, "3"]  # of the errors that the controller acts on, (m, m, rad)
    wheel_limits: Float[np.ndarray, "2"]  # least and greatest, m/s
    nominal_slip: Float[np.ndarray, "2"]
    slip_limits: Float[np.ndarray, "2 2"]  # least and greatest, of each wheel
    observer_gain: Float[np.ndarray, "3"]
    input_map: str
    dt: float  # s
    track_width: float  # m
    lag: float  # of the wheels, nominal, s
    delay_rest: float  # of the commands, nominal, beyond whole periods, s
    delay_periods: int
    most_age: float  # of a pose, s
    most_jitter: float  # of a call, s
    restarts: bool  # plans start at the error, not at the nominal one
    is_certified: bool  # for the robot
    precision: Precision
    farthest: Float[np.ndarray, " windows"]  # |z| of a plan at most
    certified_time: float  # by which poses may be old, calls off, and nothing be lost, s
    needs_slip: bool  # the certificate is about slips that are measured
    remembers_wheels: bool  # lag or delay: how wheels run at the start matters

    @property
    def horizon(self) -> int:
        """Periods of a plan."""
        return self.rows.shape[2] // 2

    @property
    def most_rows(self) -> int:
        """Active rows of a plan at most."""
        return self.rows.shape[2]

    @property
    def most_exchanges(self) -> int:
        """Exchanges of the active-set method at most."""
        return EXCHANGES * self.rows.shape[2]

    def arrays(self) -> dict[str, np.ndarray]:
        """Return all numbers by name, for a file, with each bound a row of its own."""
        named = {field.name: getattr(self, field.name) for field in fields(self)}
        precision = named.pop("precision")
        lower = named.pop("lower")
        upper = named.pop("upper")
        is_below = np.isfinite(lower).any(axis=0)
        for name in ("rows", "row_errors", "whitened"):
            array = named[name]
            named[name] = np.concatenate([array, -array[:, is_below]], axis=1)
        named["bounds"] = np.concatenate([upper, -lower[:, is_below]], axis=1)
        phases = np.array([self.delay_rest, self.dt - self.delay_rest])
        named["decays"] = np.exp(-phases / self.lag) if self.lag else np.zeros(2)
        named["to_body"] = np.array([[0.5, 0.5], [1 / self.track_width, -1 / self.track_width]])
        named["most_rows"] = self.most_rows
        named["most_exchanges"] = self.most_exchanges
        for name in ("tolerance", "row_tolerance", "dependent", "unmoved"):
            named[name] = getattr(precision, name)
        return {name: np.asarray(value) for name, value in named.items()}


def gather_constants(design: Design, precision: Precision = DOUBLE) -> Constants:
    """Return the numbers of the tube-MPC of a design.

    Args:
        design: a design.
        precision: of the QPs; tracking of the pose, gains and wheels stay in float64.
    """
    problem = design.problem
    settings = problem.scenario.controller
    actuation = find_actuation(problem.scenario)
    forecast = Forecast.of(
        *actuation.nominal(problem.reference.dt), problem.robot.track_width, problem.reference.dt
    )
    steps = problem.reference.steps
    qps = design.tube_qps
    slips = compensated_slips(problem.scenario.slip)
    low, high = slips
    of_qps = {
        name: array.astype(precision.name) for name, array in _gather_qps(qps, precision).items()
    }
    return Constants(
        **of_qps,
        tube_gain=qps.tube_gain,
        terminal_gain=qps.terminal_gain,
        transition=qps.transition,
        input_matrix=qps.input_matrix,
        window=np.asarray(design.windows.index[:steps]),
        reference_wheels=problem.schedule[: steps + 1],
        reference_poses=problem.reference.poses[: steps + 1],
        caps=problem.operating_set.support(np.eye(3)),
        wheel_limits=np.array([problem.robot.wheel_speed_min, problem.robot.wheel_speed_max]),
        nominal_slip=np.asarray(slip_bounds(problem.scenario.slip).nominal, float),
        slip_limits=np.stack([low - SLIP_ROUNDING, high + SLIP_ROUNDING]),
        observer_gain=np.array(settings.observer_gain),
        input_map=settings.input_map,
        dt=problem.reference.dt,
        track_width=problem.robot.track_width,
        lag=float(forecast.lag),
        delay_rest=float(forecast.late),
        delay_periods=forecast.whole,
        most_age=TIMING * problem.reference.dt,
        most_jitter=TIMING * problem.reference.dt,
        restarts=settings.restart,
        is_certified=design.certificate.holds_for_robot,
        precision=precision,
        farthest=_bound_plans(design),
        certified_time=CERTIFIED_TIMING * problem.reference.dt,
        needs_slip=problem.scenario.slip.is_measured,
        remembers_wheels=not problem.scenario.robot.obeys_at_once,
    )


def _bound_plans(design: Design) -> Float[np.ndarray, " windows"]:
    """Return |z| at most of plans whose inputs are within twice their caps, in every window."""
    problem = design.problem
    inputs = problem.input_set.support(np.concatenate([np.eye(2), -np.eye(2)]))
    largest = WIDER * np.tile(np.maximum(inputs[:2], inputs[2:]), problem.horizon)
    to_z = np.linalg.inv(np.swapaxes(design.tube_qps.factors.root, -1, -2))
    return np.linalg.norm(np.abs(to_z) @ largest, axis=-1)


def _gather_qps(qps: CondensedQp, precision: Precision) -> dict[str, np.ndarray]:
    """Return what plans are made of, in float64."""
    factors = qps.factors
    norms = factors.row_norms[..., None]
    unreached = np.zeros((*qps.check_errors.shape[:2], qps.linear.shape[1]))
    slack = precision.tolerance
    return {
        "rows": np.concatenate([factors.rows, unreached], axis=1),
        "row_errors": np.concatenate([qps.row_errors / norms, qps.check_errors], axis=1),
        "lower": np.concatenate([qps.lower / factors.row_norms, qps.check_lower - slack], axis=1),
        "upper": np.concatenate([qps.upper / factors.row_norms, qps.check_upper + slack], axis=1),
        "whitened": np.concatenate([factors.whitened, unreached], axis=1),
        "unwhiten": np.swapaxes(factors.root, -1, -2),
        "free_inputs": qps.free_inputs,
        "start": -factors.root @ qps.linear,
    }
