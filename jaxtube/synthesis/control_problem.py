"""What tubes, terminal sets and QPs ask of a control problem, whatever the system is.

    e+ = A(th) e + B(th) u + w,    e in E,    inputs u + errors e <= offsets,    w in W

`Problem` is that of a robot's scenario, `LinearProblem` that of a `jaxtube.LinearSystem`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, Self

import numpy as np
from jaxtyping import Float, Int

from jaxtube.synthesis.limits import InputRows
from jaxtube.synthesis.regimes import ONE_REGIME, Disturbances, RegimeRule
from sets.lmi import Objective
from sets.polytope import Polytope


class ScheduledModel(Protocol):
    """A linear model whose matrices depend on a schedule."""

    @property
    def discretisation(self) -> str:
        """How it was made: under "euler" matrices are affine in wheel speeds."""
        ...

    @property
    def vertices(self) -> Float[np.ndarray, "v p"]:
        """The schedules between which gains are mixed."""
        ...

    def weights(self, schedule: Float[np.ndarray, "... p"]) -> Float[np.ndarray, "... v"]:
        """Return the weights by which the gains at the vertices mix at a schedule."""
        ...

    def matrices(
        self, schedule: Float[np.ndarray, "... p"]
    ) -> tuple[Float[np.ndarray, "... n n"], Float[np.ndarray, "... n m"]]:
        """Return A and B at one or many schedules."""
        ...


class ScheduledReference(Protocol):
    """The schedule of a run."""

    @property
    def dt(self) -> float:
        """Length of a period, s."""
        ...

    @property
    def steps(self) -> int:
        """Periods of the run, without the preview."""
        ...


class ControlSettings(Protocol):
    """How a controller is designed."""

    @property
    def tube(self) -> str:
        """Name of the tube in use."""
        ...

    @property
    def cost(self) -> str:
        """What a plan costs: "tracking", or "deviation" from the tube's gain."""
        ...

    @property
    def restart(self) -> bool:
        """Whether plans start at the measured error."""
        ...

    @property
    def terminal_facets(self) -> int:
        """Facets of the terminal set, see `synthesis.terminal`."""
        ...

    @property
    def lmi_objective(self) -> Objective:
        """What the terminal cost is best at where no gains are given."""
        ...

    @property
    def tube_has_terminal_gain(self) -> bool:
        """Whether one gain serves tube and terminal set."""
        ...

    @property
    def terminal_set_holds_reach(self) -> bool:
        """Whether the terminal set absorbs all that W becomes by the end of a plan."""
        ...


@dataclass(frozen=True, eq=False, kw_only=True)
class ControlProblem(ABC):
    """What a design starts from, as arrays in one system of units.

    Of opposite rows of `operating_set` and `input_rows` the first half comes first, as in a box.
    `error_set` bounds the true error, `operating_set` the one that the controller acts on.

    `regimes` are the problems that would be, did all periods belong to one regime; none where they
    do. `rule` numbers them along a run. `disturbance_set` then holds the W of each.
    """

    model: ScheduledModel
    reference: ScheduledReference
    horizon: int
    error_weight: Float[np.ndarray, "n n"]
    input_weight: Float[np.ndarray, "m m"]
    error_set: Polytope
    operating_set: Polytope
    input_set: Polytope
    input_rows: InputRows
    disturbance_set: Polytope
    initial_error: Float[np.ndarray, " n"]
    regimes: tuple[Self, ...] = ()
    rule: RegimeRule = ONE_REGIME

    @property
    def every_regime(self) -> tuple[Self, ...]:
        """The problem of every regime, itself where there is one."""
        return self.regimes or (self,)

    @cached_property
    def disturbances(self) -> Disturbances:
        """The W of every regime."""
        return Disturbances(tuple(regime.disturbance_set for regime in self.every_regime))

    @property
    def period_regimes(self) -> Int[np.ndarray, " periods"]:
        """The regime of every period, preview included."""
        return self.rule.number(self.schedule)

    def rows_of(self, regimes: Int[np.ndarray, "*shape"]) -> InputRows:
        """Return the input rows of periods by their regimes, stacked in the same shape; every
        regime has as many."""
        every = [regime.input_rows for regime in self.every_regime]
        return InputRows(
            np.stack([rows.inputs for rows in every])[regimes],
            np.stack([rows.errors for rows in every])[regimes],
            np.stack([rows.offsets for rows in every])[regimes],
        )

    @property
    def input_row_count(self) -> int:
        """How many rows on input and error a period has; the second half is minus the first."""
        return len(self.every_regime[0].input_rows.offsets)

    @property
    def error_widths(self) -> Float[np.ndarray, " n"]:
        """Half widths of the box around E, in which the controller keeps the error: its units."""
        each = np.eye(self.operating_set.dimension)
        return np.maximum(self.operating_set.support(each), self.operating_set.support(-each))

    @property
    @abstractmethod
    def settings(self) -> ControlSettings:
        """How its controller is designed."""

    @property
    @abstractmethod
    def schedule(self) -> Float[np.ndarray, "periods p"]:
        """The schedule of every period, preview included."""

    @property
    @abstractmethod
    def noise(self) -> Float[np.ndarray, " n"]:
        """Half widths of the error of what is measured."""
