"""A linear system of a user's own, parameter-varying in a polytope, with limits, weights and
schedule.

    x+ = A(th) x + B(th) u + w,    A(th) = sum_i th_i A_i,    B(th) = sum_i th_i B_i
    x in E,    u in U,    w in W,    th_i >= 0,    sum_i th_i = 1

Source: Blanchini, Miani, Set-Theoretic Methods in Control, 2008, sections 2.3 and 7.1 (polytopic
systems).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxtube.scenario.refusal import ScenarioError
from jaxtube.systems.checks import (
    check_bounded_around_origin,
    check_choice,
    check_count,
    check_holds_origin,
    check_weights,
    read_matrices,
    read_schedule,
    read_set,
    read_vector,
    refuse,
)
from jaxtube.systems.motion import Motion
from jaxtube.systems.proof import Claim, Proof
from sets.lmi import Objective
from sets.polytope import Polytope

TUBES = ("sequence", "summed")
"""Tubes along the schedule that is given, or for any order of the vertices; see `sets.tubes`. Its
`hull` is too narrow for plans that are made anew in every period."""


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class LinearSystem:
    """A discrete-time linear system, parameter-varying in a polytope, and what its tube-MPC is to
    keep.

    Sets are a `sets.polytope.Polytope`, or the half widths of a box about the origin. Units are
    the user's own; nothing here depends on them.

    Attributes:
        A: of the vertices, (v, n, n), or one matrix (n, n) for all.
        B: of the vertices, (v, n, m), or one matrix (n, m) for all.
        E: limits of the state, bounded, the origin inside.
        U: limits of the input, bounded, the origin inside.
        W: all disturbances of a period; bounded, and it holds the origin. None for what is proved
            of `motion`.
        motion: that of a nonlinear system, which the linear one stands for; the certificate then
            says whether W holds all that it adds.
        Q: weight of the state in the cost of a plan, positive semidefinite.
        R: weight of the input, positive definite.
        K: gains u = +K x, (m, n) or one a vertex, mixed as the vertices are; None for those of a
            linear matrix inequality (one for all where B varies).
        horizon: periods of a plan.
        schedule: weights th of the vertices in every period of a run, (periods, v); what is known
            of the future, beyond its end the last row. None for a system of one vertex.
        periods: of a run, where no schedule is given.
        start: initial state.
        tube: "sequence" (along the schedule, then certified for any other order as well), or
            "summed" (one tube for every order). Both predict along the schedule; where nobody knows
            it, see `without_schedule`.
        terminal_facets: that the terminal set may have; it is smaller than the largest one where
            that has more.
        objective: what the inequality's cost is best at ("trace_s", "trace_p", "logdet").
        dt: length of a period, for time axes alone.
        state_names, input_names: in texts; x1, x2, .. and u1, u2, .. unless given.
        proof: what is proved of `motion`; made where it is None or of other data.
    """

    A: Float[np.ndarray, "v n n"]
    B: Float[np.ndarray, "v n m"]
    E: Polytope
    U: Polytope
    Q: Float[np.ndarray, "n n"]
    R: Float[np.ndarray, "m m"]
    W: Polytope | None = None
    motion: Motion | None = None
    K: Float[np.ndarray, "v m n"] | None = None
    horizon: int = 10
    schedule: Float[np.ndarray, "periods v"] | None = None
    periods: int = 60
    start: Float[np.ndarray, " n"] | None = None
    tube: str = "sequence"
    terminal_facets: int = 40
    objective: Objective = "trace_s"
    dt: float = 1.0
    state_names: tuple[str, ...] = field(default=())
    input_names: tuple[str, ...] = field(default=())
    proof: Proof | None = None

    def __post_init__(self):
        A, B = read_matrices(self.A, self.B)
        count, states, inputs = B.shape
        self._keep(A=A, B=B)
        self._keep(E=read_set("E", self.E, states), U=read_set("U", self.U, inputs))
        for name in ("E", "U"):
            check_bounded_around_origin(name, getattr(self, name))
        self._read_disturbances()
        self._keep(Q=check_weights("Q", self.Q, states), R=check_weights("R", self.R, inputs))
        if self.K is not None:
            gains = np.asarray(self.K, float)
            shape = (count, inputs, states)
            if gains.shape not in (shape, shape[1:]) or not np.all(np.isfinite(gains)):
                raise refuse("K", gains.shape, "is no shape of gains", f"give {shape[1:]}")
            self._keep(K=np.broadcast_to(gains, shape))
        check_count("horizon", self.horizon, 1)
        check_count("periods", self.periods, 1)
        check_count("terminal_facets", self.terminal_facets, states + 1)
        check_choice("tube", self.tube, TUBES)
        check_choice("objective", self.objective, ("trace_s", "trace_p", "logdet"))
        self._keep(schedule=read_schedule(self.schedule, count, self.periods))
        start = np.zeros(states) if self.start is None else self.start
        self._keep(start=read_vector("start", start, states))
        self._keep_names("state_names", states, "x")
        self._keep_names("input_names", inputs, "u")

    @property
    def states(self) -> int:
        """How many states it has."""
        return self.B.shape[1]

    @property
    def inputs(self) -> int:
        """How many inputs it has."""
        return self.B.shape[2]

    @property
    def has_one_input_matrix(self) -> bool:
        """Whether B is the same at all vertices."""
        return len(np.unique(self.B, axis=0)) == 1

    @property
    def disturbance_set(self) -> Polytope:
        """W, given or proved."""
        assert self.W is not None  # which reading fills in
        return self.W

    def without_schedule(self) -> LinearSystem:
        """Return the system for a controller that does not know th, now or later: one vertex, the
        mean of all, and in W what they add to it, (A_i - A) x + (B_i - B) u over E and U.

        Its guarantee holds for every th in every period. K, where given, is that of the mean.
        """
        A = self.A.mean(axis=0)
        B = self.B.mean(axis=0)
        corners_of_E = self.E.vertices()
        corners_of_U = self.U.vertices()
        added = []
        for A_i, B_i in zip(self.A, self.B, strict=True):
            of_states = corners_of_E @ (A_i - A).T
            of_inputs = corners_of_U @ (B_i - B).T
            added.append((of_states[:, None] + of_inputs).reshape(-1, self.states))
        unmodelled = Polytope.from_vertices(np.concatenate(added))
        K = None if self.K is None else self.K.mean(axis=0)
        periods = len(self.schedule) if self.schedule is not None else self.periods
        uncertain = None if self.motion is None else self.motion.without_schedule(len(self.A))
        return replace(
            self,
            A=A[None],
            B=B[None],
            W=self.disturbance_set.minkowski_sum(unmodelled),
            motion=uncertain,
            K=K,
            schedule=None,
            periods=periods,
        )

    def with_weights(self, Q: Float[np.ndarray, "n n"], R: Float[np.ndarray, "m m"]):
        """Return the system with other weights."""
        return replace(self, Q=Q, R=R)

    def _read_disturbances(self) -> None:
        """Prove W where there is a motion, and read it where it is given."""
        if self.motion is not None:
            claim = Claim(self.motion, self.A, self.B, self.E, self.U)
            if self.proof is None or not self.proof.is_of(claim):
                self._keep(proof=Proof.of(claim))
        if self.W is None:
            if self.proof is None:
                raise refuse("W", "none", "is missing", "give W, or a motion of which it is proved")
            self._keep(W=self.proof.disturbance_set)
        self._keep(W=read_set("W", self.W, self.states))
        check_holds_origin("W", self.disturbance_set)

    def _keep(self, **values: Any) -> None:
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def _keep_names(self, name: str, count: int, letter: str) -> None:
        names = tuple(getattr(self, name)) or tuple(f"{letter}{i + 1}" for i in range(count))
        if len(names) != count:
            raise refuse(name, names, f"has {len(names)} names", f"give {count}")
        self._keep(**{name: names})

    def __repr__(self) -> str:
        scheduled = f", {len(self.A)} vertices" if len(self.A) > 1 else ""
        return (
            f"<LinearSystem: {self.states} states, {self.inputs} inputs{scheduled}; tube "
            f"{self.tube}, horizon {self.horizon}>"
        )


def require_system(value: object) -> LinearSystem:
    """Return a linear system.

    Raises:
        ScenarioError: one line, for anything else.
    """
    if isinstance(value, LinearSystem):
        return value
    raise ScenarioError(f"system: is {type(value).__name__}; give a jaxtube.LinearSystem")
