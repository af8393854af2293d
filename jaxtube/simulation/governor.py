"""A governor for one robot: it keeps the reference within what the certificate is about, and leads
a robot that is elsewhere back into it.

The reference that the controller follows is the governor's own (`route`). Always, it is one of
wheel speeds within the certified box, N periods of which are committed (`governing`):

* wheel speeds that are wished for, and revised at any time, are followed as far as there is a plan;
* from an error without a plan, at the start or after what no certificate assumes, the reference
  begins anew near the robot, and joins the path that is asked for;
* another path is joined from the end of what is committed.

Where the reference begins anew, the error is a share of the error before: the largest, but for a
little, with which it lies in the invariant set Omega. From there every window has a plan.

Source: new.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxtube import qp
from jaxtube.control.protocol import WheelMap
from jaxtube.paths.joining import find_gap
from jaxtube.paths.profile import WheelLimits
from jaxtube.plant.protocol import Command, Measurement
from jaxtube.plant.reference import Reference
from jaxtube.plant.slip_bounds import slip_bounds
from jaxtube.precision import in_64_bits
from jaxtube.simulation import components
from jaxtube.simulation.backup import Backup
from jaxtube.simulation.governing import Governed, LivePlanner, govern
from jaxtube.simulation.route import Route
from jaxtube.synthesis.parts import Design, require_design

INSIDE = 0.99
"""How far into Omega an error is put where the reference begins anew."""

AHEAD = 16
"""Periods whose QPs are made together where the reference is known ahead."""

BEYOND = 1e-9
"""By how much wheel speeds of a path may leave the box, m/s: rounding."""


class GovernedStep(NamedTuple):
    """What one period is to do, and what became of what was asked for.

    Attributes:
        wheels: speeds asked of the wheels (right, left), m/s, not saturated.
        inputs: the virtual inputs that they realise (u1 m/s, u2 rad/s).
        status: of the QP: `qp.SOLVED`, `qp.INFEASIBLE` or `qp.UNSOLVED`.
        residual: of its optimality conditions.
        active: whether some row of it is active.
        state: "followed": the wheel speeds asked for are driven; "held back": a share of a revision
            was accepted, or nothing of it; "joining": on the way onto what is asked for; "lost":
            no plan, and the input is that of the backup.
        share: of a revision that was accepted, in [0, 1]; 1 where nothing was revised.
        errors: from the governor's reference, measured (m, m, rad).
        reference_pose: of that reference at the start of the period (x m, y m, heading rad).
        reference_wheels: its wheel speeds in this period, m/s.
        distance: of that reference from the place asked for, m.
        late: periods by which what is asked for is followed late, or will be once it is joined.
    """

    wheels: Float[np.ndarray, "2"]
    inputs: Float[np.ndarray, "2"]
    status: int
    residual: float
    active: bool
    state: str
    share: float
    errors: Float[np.ndarray, "3"]
    reference_pose: Float[np.ndarray, "3"]
    reference_wheels: Float[np.ndarray, "2"]
    distance: float
    late: int

    @property
    def is_solved(self) -> bool:
        """Whether there is a plan."""
        return self.status == qp.SOLVED


class Governor:
    """The controller of one robot under a governor of its reference, asked once a period.

        governor = jt.Governor(design)
        step = governor(pose)  # along the design's reference, from wherever the robot is
        step = governor(pose, wish=wheels)  # at wheel speeds that may be revised at any time

    Poses are those that the controller acts on, (x m, y m, heading rad) in the world's frame.
    """

    @in_64_bits
    def __init__(self, design: Design, reference: Reference | None = None):
        """Prepare plans along any wheel speeds in the certified box.

        Args:
            design: certified for the wheel speeds of a box, in any order.
            reference: the path asked for; the design's own unless given.

        Raises:
            ScenarioError: for a design without such a certificate.
            ValueError: for a path whose wheel speeds leave the box, or of another period.
        """
        require_design(design)
        self._design = design
        self._planner = LivePlanner(design)
        self._planner.compile_solver()
        problem = design.problem
        least, greatest = self._planner.live.box
        self._limits = WheelLimits(
            float(least.max()), float(greatest.min()), None, problem.robot.track_width
        )
        self._slip = np.asarray(slip_bounds(problem.scenario.slip).nominal, float)
        self._command = _compile_command(components.make_wheel_map(problem))
        self._first = self._require_path(problem.reference if reference is None else reference)
        self.restart()

    def restart(self) -> None:
        """Forget everything: the path asked for at first begins with the next call."""
        self._route = Route(self._first, self._limits, self._design.problem.horizon)
        self._backup = Backup(self._design, np.full((1, 3), np.nan))

    @property
    def has_ended(self) -> bool:
        """Whether the path has been driven to its end."""
        return self._route.has_ended

    def follow(self, reference: Reference) -> None:
        """Ask for another path, whose first period begins with the next call; it is joined from the
        end of what is committed.

        Raises:
            ValueError: for wheel speeds that leave the box, or of another period.
        """
        self._route.follow(self._require_path(reference))

    def _require_path(self, reference: Reference) -> Reference:
        """Refuse a path that the certificate is not about; wheel speeds that leave the box by
        rounding are put back."""
        box = self._planner.live.box
        dt = self._design.problem.reference.dt
        wheels = np.clip(reference.wheels, *box)
        beyond = float(np.max(np.abs(wheels - reference.wheels)))
        if not beyond <= BEYOND:
            raise ValueError(
                f"reference: wheel speeds leave the certified {box[0].min():g} to "
                f"{box[1].max():g} m/s by {beyond:.3g} m/s; drive the path within them"
            )
        if reference.dt != dt:
            raise ValueError(
                f"reference: dt = {reference.dt:g} s: the design's period is {dt:g} s; sample the "
                "path in such periods"
            )
        return Reference(wheels, reference.poses, dt, reference.steps)

    @in_64_bits
    def __call__(
        self,
        pose: Float[np.ndarray, "3"],
        wish: Float[np.ndarray, "..."] | None = None,
        slip: Float[np.ndarray, "2"] | None = None,
    ) -> GovernedStep:
        """Return what the next period is to do.

        Args:
            pose: at its start (see the class). Where it is no number the robot is taken to be
                where the last plan has it.
            wish: wheel speeds (right, left), m/s, wanted in the N periods that begin now (N, 2), or
                in all of them (2,), in place of what was asked for before; what leaves the
                certified box is put on its edge. None: as before.
            slip: what is measured of the slips (right, left); the nominal ones unless given.

        Raises:
            ValueError: for other shapes, beyond the end of the path, or where the first pose is no
                number.
        """
        pose = np.asarray(pose, float)
        slip = self._slip if slip is None else np.asarray(slip, float)
        if pose.shape != (3,) or slip.shape != (2,):
            raise ValueError(
                f"pose, slip: shapes {pose.shape} and {slip.shape}; give (3,) and (2,)"
            )
        if wish is not None:
            self._route.wish(self._take_wish(wish))
        if self._route.has_ended:
            raise ValueError(
                "the path has ended; call restart(), or follow(reference) for another one"
            )
        is_missing = not np.all(np.isfinite(pose))
        errors = self._backup.predicted[0] if is_missing else find_errors(pose, self._route.pose)
        if not np.all(np.isfinite(errors)):
            raise ValueError(f"pose = {pose.tolist()}: is missing at first; give three numbers")
        decided = self._decide(errors)
        if decided.plans.status[0] != qp.SOLVED and not is_missing:
            errors = self._begin_anew(pose, errors)
            decided = self._decide(errors)
        return self._act(errors, decided, slip)

    def _take_wish(self, wish) -> Float[np.ndarray, "horizon 2"]:
        horizon = self._design.problem.horizon
        wheels = np.asarray(wish, float)
        if wheels.shape not in ((2,), (horizon, 2)) or not np.all(np.isfinite(wheels)):
            raise ValueError(
                f"wish: is of shape {wheels.shape}, or no number; give ({horizon}, 2) wheel "
                "speeds, or (2,) for all periods"
            )
        return np.clip(np.broadcast_to(wheels, (horizon, 2)), *self._planner.live.box)

    def _decide(self, errors: Float[np.ndarray, "3"]) -> Governed:
        if self._route.joins is not None:
            self._planner.look_ahead(self._route.list_windows(AHEAD))
        committed = self._route.committed
        wished = self._route.wished
        return govern(self._planner, errors[None], committed[None], wished[None])

    def _begin_anew(
        self, pose: Float[np.ndarray, "3"], errors: Float[np.ndarray, "3"]
    ) -> Float[np.ndarray, "3"]:
        """Put the reference so near to the robot that every window has a plan; return the error.

        Either near where it was, or where the target has been: what is sooner followed, late as it
        is.
        """
        route = self._route
        errors = errors * min(1.0, INSIDE / float(self._use_omega(errors)))
        place = (errors[0] + 1j * errors[1]) * np.exp(1j * pose[2])
        route.begin_anew(pose + np.array([place.real, place.imag, errors[2]]))
        past = find_errors(pose, route.past)
        fitting = np.flatnonzero(self._use_omega(past) <= INSIDE)
        late = len(past) - 1 - fitting[-1] if len(fitting) else np.inf
        if route.joins is not None and late >= route.joins + route.late:
            return errors
        if not len(fitting):
            return errors
        route.wait(int(fitting[-1]))
        return past[fitting[-1]]

    def _use_omega(self, errors: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "..."]:
        """Return what errors use of Omega, 1 on a facet."""
        omega = self._design.terminal.invariant
        assert omega is not None  # or else no order but one would be certified
        return np.max(errors @ omega.normals.T / omega.offsets, axis=-1)

    def _act(
        self, errors: Float[np.ndarray, "3"], decided: Governed, slip: Float[np.ndarray, "2"]
    ) -> GovernedStep:
        """Return the step of a decision, and let the reference drive on."""
        route = self._route
        window = decided.windows[0]
        share = float(decided.shares[0])
        has_plan = decided.plans.status == qp.SOLVED
        inputs = self._backup.act(decided.plans, has_plan, errors[None], window[None, 0])
        measurement = Measurement(jnp.asarray(errors[None]), jnp.asarray(slip[None]))
        command = self._command(inputs, measurement, window[0])
        step = GovernedStep(
            wheels=np.asarray(command.wheels)[0],
            inputs=inputs[0],
            status=int(decided.plans.status[0]),
            residual=float(decided.plans.residual[0]),
            active=bool(decided.plans.active[0]),
            state=_name_state(bool(has_plan[0]), share, route.joins),
            share=share,
            errors=errors,
            reference_pose=route.pose,
            reference_wheels=window[0],
            distance=route.distance,
            late=route.late,
        )
        route.advance(share, window)
        return step


def find_errors(
    pose: Float[np.ndarray, "3"], references: Float[np.ndarray, "... 3"]
) -> Float[np.ndarray, "... 3"]:
    """Return the tracking errors of a pose from others (m, m, rad), headings without whole
    turns."""
    gap = find_gap(pose, references)
    offset = (gap[..., 0] + 1j * gap[..., 1]) * np.exp(-1j * pose[2])
    return np.stack([np.real(offset), np.imag(offset), gap[..., 2]], axis=-1)


def _compile_command(wheel_map: WheelMap) -> Callable[..., Command]:
    """Compile how the inputs of one robot become wheel speeds."""
    measurement = Measurement(jnp.zeros((1, 3)), jnp.zeros((1, 2)))
    return jax.jit(wheel_map.command).lower(np.zeros((1, 2)), measurement, np.zeros(2)).compile()


def _name_state(has_plan: bool, share: float, joins: int | None) -> str:
    """Return what a period is called (see `GovernedStep`)."""
    if not has_plan:
        return "lost"
    if share < 1.0:
        return "held back"
    return "joining" if joins else "followed"
