"""The control problem of a linear system: its model, schedule, sets in pairs of rows, and gains.

Loops of mixed gains, with th on the unit simplex and both A, B and K mixed by it:

    A(th) + B(th) K(th) = sum_i th_i^2 (A_i + B_i K_i)
                        + sum_{i<j} 2 th_i th_j (A_i + B_i K_j + A_j + B_j K_i) / 2

so that the loops (i, i) and the means of (i, j) and (j, i), each with the mean of both gains, hold
all of them; where all B_i or all K_i are equal those of the vertices do.

Source: Tanaka, Ikeda, Wang 1998, IEEE Trans. Fuzzy Systems 6(2), section II (loops of mixed gains).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from jaxtube.synthesis.control_problem import ControlProblem
from jaxtube.synthesis.gain_schedule import GainSchedule
from jaxtube.synthesis.limits import InputRows
from jaxtube.systems.system import LinearSystem
from sets.lmi import Objective
from sets.polytope import Polytope

OPPOSITE = 1e-12
"""Distance from the opposite of a unit normal within which another one is it."""


@dataclass(frozen=True, eq=False)
class PolytopicModel:
    """A linear model whose matrices are mixtures of those of its vertices."""

    A: Float[np.ndarray, "v n n"]
    B: Float[np.ndarray, "v n m"]

    discretisation = "polytopic"

    @property
    def vertices(self) -> Float[np.ndarray, "v v"]:
        """The schedules of the vertices: unit vectors."""
        return np.eye(len(self.A))

    def weights(self, schedule: Float[np.ndarray, "... v"]) -> Float[np.ndarray, "... v"]:
        """Return the weights of the vertices: the schedule itself."""
        return schedule

    def matrices(
        self, schedule: Float[np.ndarray, "... v"]
    ) -> tuple[Float[np.ndarray, "... n n"], Float[np.ndarray, "... n m"]]:
        """Return A and B at one or many schedules."""
        return np.tensordot(schedule, self.A, axes=1), np.tensordot(schedule, self.B, axes=1)


@dataclass(frozen=True, eq=False)
class MixedGain(GainSchedule):
    """A gain that is mixed from those of the vertices as the model is."""

    model: PolytopicModel

    @property
    def corner_gains(self) -> Float[np.ndarray, "v m n"]:
        """The gains of the vertices."""
        return self.vertices

    @cached_property
    def pairs(self) -> tuple[Float[np.ndarray, "w n n"], Float[np.ndarray, "w m n"]]:
        """Loops and gains whose joint mixtures are (A + B K, K) at every schedule (see the
        module)."""
        A = self.model.A
        B = self.model.B
        K = self.vertices
        own = A + B @ K
        if is_one(B) or is_one(K):
            return own, K
        first, second = np.triu_indices(len(A), k=1)
        crossed = A[first] + B[first] @ K[second] + A[second] + B[second] @ K[first]
        loops = np.concatenate([own, crossed / 2])
        return loops, np.concatenate([K, (K[first] + K[second]) / 2])


@dataclass(frozen=True, eq=False)
class WeightSchedule:
    """The weights of the vertices in every period of a run, preview included."""

    weights: Float[np.ndarray, "periods v"]
    dt: float
    steps: int


@dataclass(frozen=True)
class LinearSettings:
    """How the controller of a linear system is designed; see `ControlSettings`."""

    tube: str
    terminal_facets: int
    lmi_objective: Objective

    cost = "tracking"
    restart = True
    tube_has_terminal_gain = True

    @property
    def terminal_set_holds_reach(self) -> bool:
        """Whether the terminal set absorbs all that W becomes: where the tube knows no order."""
        return self.tube != "sequence"


@dataclass(frozen=True, eq=False, kw_only=True)
class LinearProblem(ControlProblem):
    """What the design of a linear system starts from; its state is the error."""

    system: LinearSystem
    model: PolytopicModel
    reference: WeightSchedule

    @property
    def settings(self) -> LinearSettings:
        """How the controller is designed."""
        system = self.system
        return LinearSettings(system.tube, system.terminal_facets, system.objective)

    @property
    def schedule(self) -> Float[np.ndarray, "periods v"]:
        """The weights of the vertices in every period, preview included."""
        return self.reference.weights

    @property
    def noise(self) -> Float[np.ndarray, " n"]:
        """The state is measured exactly."""
        return np.zeros(self.system.states)

    @property
    def error_names(self) -> tuple[str, ...]:
        """Names of the pairs of rows of E."""
        half = len(self.operating_set.offsets) // 2
        return _name_rows(self.operating_set.normals[:half], self.system.state_names)

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the pairs of rows of U."""
        half = len(self.input_rows.offsets) // 2
        return _name_rows(self.input_rows.inputs[:half], self.system.input_names)

    def along(self, weights: Float[np.ndarray, "periods v"], steps: int) -> LinearProblem:
        """Return the problem along other weights, preview included."""
        reference = WeightSchedule(weights, self.reference.dt, steps)
        return replace(self, reference=reference)


def make_linear_problem(system: LinearSystem) -> LinearProblem:
    """Return the control problem of a linear system."""
    assert system.schedule is not None  # which reading fills in
    assert system.start is not None
    beyond = np.repeat(system.schedule[-1:], system.horizon, axis=0)
    weights = np.concatenate([system.schedule, beyond])
    E = pair_rows(system.E)
    U = pair_rows(system.U)
    count = len(U.offsets)
    return LinearProblem(
        system=system,
        model=PolytopicModel(system.A, system.B),
        reference=WeightSchedule(weights, system.dt, len(system.schedule)),
        horizon=system.horizon,
        error_weight=system.Q,
        input_weight=system.R,
        error_set=E,
        operating_set=E,
        input_set=U,
        input_rows=InputRows(U.normals, np.zeros((count, system.states)), U.offsets),
        disturbance_set=system.disturbance_set,
        initial_error=system.start,
    )


def mix_gains(problem: LinearProblem, vertices: Float[np.ndarray, "v m n"]) -> MixedGain:
    """Return the gain with these values at the vertices."""
    return MixedGain(problem.model, vertices.mean(axis=0), vertices)


def is_one(matrices: Float[np.ndarray, "v a b"]) -> bool:
    """Return whether all matrices are the same."""
    return len(np.unique(matrices, axis=0)) == 1


def pair_rows(polytope: Polytope) -> Polytope:
    """Return a bounded polytope by unit rows of which the second half is minus the first.

    A row without its opposite gets that with the support number of the set: it cuts nothing off.
    """
    unit = polytope.with_unit_normals()
    left = list(range(len(unit.offsets)))
    normals = []
    upper = []
    lower = []
    while left:
        row = left.pop(0)
        normal = unit.normals[row]
        distances = np.linalg.norm(unit.normals[left] + normal, axis=1)
        normals.append(normal)
        upper.append(unit.offsets[row])
        if len(left) and distances.min() <= OPPOSITE:
            lower.append(unit.offsets[left.pop(int(np.argmin(distances)))])
        else:
            lower.append(float(polytope.support(-normal)))
    return Polytope(np.concatenate([normals, -np.array(normals)]), np.array(upper + lower))


def _name_rows(rows: Float[np.ndarray, "k n"], names: tuple[str, ...]) -> tuple[str, ...]:
    """Return what rows bound, in the names of coordinates."""
    return tuple(_name_row(row, names) for row in rows)


def _name_row(row: Float[np.ndarray, " n"], names: tuple[str, ...]) -> str:
    """Return a weighted sum of names; a name alone where the row is that of a coordinate."""
    along = np.flatnonzero(np.abs(row) > OPPOSITE)
    if len(along) == 1:
        return names[along[0]]
    return " ".join(f"{row[i]:+.3g} {names[i]}" for i in along)
