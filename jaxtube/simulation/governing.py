"""A governor of revised previews: what of a revision is accepted, so that a plan is never lost.

The certificate of a tube-MPC is about wheel speeds of the reference that are known N periods ahead.
A governor knows them by keeping its word: N pairs are committed. In every period the oldest is
driven, and one comes in at the end, any in the certified box: that the window so shifted has a plan
is what the certificate proves. A revision of what is already committed is accepted where its window
has a plan from the present error, too. Else a share of it is:

    window = (1 - share) committed + share wished        share in SHARES, the largest with a plan

All of these lie in the box, which is convex. With the share 0 what was committed goes on.

From an error in the invariant set Omega every window has a plan, g_j = K(th) e_j: there every
revision is accepted as a whole.

Sources: Bemporad, IEEE Transactions on Automatic Control 1998, and Gilbert, Kolmanovsky, Automatica
2002, for reference governors; that the parameters of the model are governed is new.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxtube import qp
from jaxtube.control import planning
from jaxtube.control.planning import CondensedQp
from jaxtube.synthesis.live import LiveQps, LiveWindows
from jaxtube.synthesis.parts import Design

SHARES = (1.0, 0.75, 0.5, 0.25)
"""Shares of a revision that are tried, one after the other, before it is held back."""


class Plans(NamedTuple):
    """What is planned for each of several robots, and the outcome of its QP: `status` is
    `qp.SOLVED` where there is a plan."""

    inputs: Float[np.ndarray, "robots horizon 2"]  # zero where there is none
    status: Int[np.ndarray, " robots"]
    residual: Float[np.ndarray, " robots"]
    active: Bool[np.ndarray, " robots"]


class Governed(NamedTuple):
    """What a governor decided for each of several robots."""

    shares: Float[np.ndarray, " robots"]  # of the revision that were accepted
    windows: Float[np.ndarray, "robots horizon 2"]  # committed from now on, m/s
    plans: Plans


class LivePlanner:
    """Plans along windows of wheel speeds that nobody knew when the design was made, of several
    robots at once, each with a window of its own."""

    def __init__(self, design: Design):
        """Refuse a design that is not certified for wheel speeds in any order (see
        `live.require_any_order`)."""
        self.live = LiveWindows(design)
        self._caps = design.problem.operating_set.support(np.eye(3))
        self._known = np.zeros((0, design.problem.horizon, 2))
        self._live = None

    def compile_solver(self) -> None:
        """Compile now what the first plans with active rows would wait for."""
        window = self.live.box[:1, None].repeat(self._known.shape[1], axis=1)
        qps = self.live.condense(window).qps
        self._ask_solver(qps, 0, np.zeros((1, 3)))
        _solve(planning.take_qp(qps, 0), np.zeros(3))

    def look_ahead(self, windows: Float[np.ndarray, "k horizon 2"]) -> None:
        """Condense windows of which the first is due now and the others will be, unless it has been
        done: together they take much less time than one by one."""
        if not len(self._find_known(windows[0])):
            self._known = windows.copy()
            self._live = self.live.condense(windows)

    def _find_known(self, window: Float[np.ndarray, "horizon 2"]) -> Int[np.ndarray, " k"]:
        return np.flatnonzero(np.all(self._known == window, axis=(1, 2)))

    def _condense(self, windows: Float[np.ndarray, "robots horizon 2"]) -> LiveQps:
        """Return the QPs of windows; that of a single one may be at hand."""
        known = self._find_known(windows[0]) if len(windows) == 1 else []
        if not len(known):
            return self.live.condense(windows)
        return jax.tree.map(lambda stack: stack[known[:1]], self._live)

    def plan(
        self, windows: Float[np.ndarray, "robots horizon 2"], errors: Float[np.ndarray, "robots 3"]
    ) -> Plans:
        """Plan from measured errors (m, m, rad) along windows within the box."""
        live = self._condense(windows)
        qps = live.qps
        is_free = _are_free(qps, errors)
        inputs = np.einsum("rie,re->ri", qps.free_inputs, errors)
        plans = Plans(
            inputs=inputs.reshape(windows.shape),
            status=np.full(len(errors), qp.SOLVED),
            residual=_bound_rounding(qps, errors),
            active=np.zeros(len(errors), bool),
        )
        for robot in np.flatnonzero(~is_free).tolist():
            for whole, part in zip(plans, self._ask_solver(qps, robot, errors), strict=True):
                whole[robot] = part
        within_caps = np.all(np.abs(errors) <= self._caps, axis=1)
        plans.status[~within_caps] = qp.INFEASIBLE
        plans.status[~live.within_slack] = qp.UNSOLVED
        return plans

    def _ask_solver(
        self, qps: CondensedQp, robot: int, errors: Float[np.ndarray, "robots 3"]
    ) -> Plans:
        """Return the plan of one robot from the solver; only what its quick program leaves goes to
        the whole one."""
        whole = planning.take_qp(qps, robot)
        quick = whole._replace(factors=whole.factors._replace(iterated=None))
        plan = Plans(*_solve(quick, errors[robot]))
        if plan.status == qp.UNSOLVED:
            plan = Plans(*_solve(whole, errors[robot]))
        return plan


def _are_free(qps: CondensedQp, errors: Float[np.ndarray, "robots 3"]) -> Bool[np.ndarray, "r"]:
    """Return which robots meet all bounds by the plan without constraints."""
    within = np.ones(len(errors), bool)
    for lower, rows, upper in (
        (qps.lower, qps.free_rows, qps.upper),
        (qps.check_lower, qps.check_errors, qps.check_upper),
    ):
        values = np.einsum("rme,re->rm", rows, errors)
        within &= np.all((lower <= values) & (values <= upper), axis=1)
    return within


def _bound_rounding(
    qps: CondensedQp, errors: Float[np.ndarray, "robots 3"]
) -> Float[np.ndarray, " robots"]:
    """Return what rounding may leave of the residual of a plan without constraints, as
    `planning.free_plan`."""
    terms = qps.free_inputs.shape[1] + 5
    return terms * np.finfo(float).eps * qps.free_scale * np.max(np.abs(errors), axis=1)


@jax.jit
def _solve(condensed: CondensedQp, error) -> tuple:
    """Return the plan of one robot."""
    plan = planning.constrained_plan(condensed, error[None])
    inputs = jnp.where(plan.status[0] == qp.SOLVED, plan.inputs[0], 0.0)
    return inputs, plan.status[0], plan.residual[0], plan.active[0]


def shift(
    committed: Float[np.ndarray, "robots horizon 2"], newest: Float[np.ndarray, "robots 2"]
) -> Float[np.ndarray, "robots horizon 2"]:
    """Return windows a period later: the oldest pair has been driven, and one comes in."""
    return np.concatenate([committed[:, 1:], newest[:, None]], axis=1)


def govern(
    planner: LivePlanner,
    errors: Float[np.ndarray, "robots 3"],
    committed: Float[np.ndarray, "robots horizon 2"],
    wished: Float[np.ndarray, "robots horizon 2"],
) -> Governed:
    """Return the largest share of each revision that has a plan, with the plan.

    Args:
        planner: of the design.
        errors: measured, (m, m, rad).
        committed: what is committed for the periods that begin now, within the box, m/s.
        wished: what is wished for them instead, within the box, m/s.

    Returns:
        What was decided. A plan whose status is not `qp.SOLVED` belongs to a robot whose committed
        window has no plan either: something happened that the certificate does not assume.
    """
    count = len(errors)
    plans = Plans(
        np.zeros_like(committed), np.zeros(count, int), np.zeros(count), np.zeros(count, bool)
    )
    decided = Governed(np.zeros(count), committed.copy(), plans)
    waiting = np.arange(count)
    for share in (*SHARES, 0.0):
        windows = (1.0 - share) * committed[waiting] + share * wished[waiting]
        windows = np.clip(windows, *planner.live.box)  # rounding may leave the box
        found = planner.plan(windows, errors[waiting])
        is_taken = (found.status == qp.SOLVED) | (share == 0.0)
        robots = waiting[is_taken]
        decided.shares[robots] = share
        decided.windows[robots] = windows[is_taken]
        for whole, part in zip(decided.plans, found, strict=True):
            whole[robots] = part[is_taken]
        waiting = waiting[~is_taken]
        if not len(waiting):
            break
    return decided


def accept_all(
    planner: LivePlanner,
    errors: Float[np.ndarray, "robots 3"],
    committed: Float[np.ndarray, "robots horizon 2"],
    wished: Float[np.ndarray, "robots horizon 2"],
) -> Governed:
    """Return every revision as a whole, whether it has a plan or not: what a tube-MPC without a
    governor does. Arguments are those of `govern`."""
    return Governed(np.ones(len(errors)), wished.copy(), planner.plan(wished, errors))
