"""The parts of a design: problem, gains, tubes, terminal set, bounds, controllers, certificate."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import jax
import numpy as np
from jaxtyping import Float

from jaxtube.arguments import describe_type
from jaxtube.control.planning import CondensedQp
from jaxtube.storage import StoredResult, write_result
from jaxtube.synthesis import condense
from jaxtube.synthesis.condense import Bounds
from jaxtube.synthesis.gains import Gain
from jaxtube.synthesis.problem import Problem
from jaxtube.synthesis.terminal import Terminal
from jaxtube.synthesis.tightening import Tightening
from jaxtube.synthesis.tubes import Tube
from jaxtube.synthesis.windows import Windows
from sets.certificate import Certificate
from sets.lmi import TerminalCost

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, repr=False)
class Condensed:
    """The condensed MPC with the tube and without, each made when it is first asked for."""

    problem: Problem
    windows: Windows
    terminal: Terminal
    cost: Float[np.ndarray, "3 3"]
    bounds: Bounds

    @cached_property
    def with_tube(self) -> CondensedQp:
        """The tube-MPC."""
        return self._condense(self.bounds)

    @cached_property
    def without_tube(self) -> CondensedQp:
        """The MPC of E and U untightened, without a terminal set."""
        return self._condense(condense.plain_bounds(self.problem, self.windows, self.terminal))

    def _condense(self, bounds: Bounds) -> CondensedQp:
        return condense.condense(self.problem, self.windows, self.terminal, self.cost, bounds)


@dataclass(frozen=True, eq=False, repr=False)
class Design:
    """Everything computed offline for one scenario.

    Before `finish` the certificate is empty: nothing was checked.
    """

    problem: Problem
    lqr_gain: Float[np.ndarray, "2 3"]  # K^n at the centre of the box
    tube_gain: Gain
    cost: TerminalCost
    windows: Windows
    tubes: dict[str, Tube]
    tightening: Tightening
    terminal: Terminal
    bounds: Bounds
    condensed: Condensed
    certificate: Certificate = field(default_factory=Certificate)
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def tube(self) -> Tube:
        """The tube in use."""
        return self.tubes[self.problem.scenario.controller.tube]

    @property
    def first_window(self) -> int:
        """The window that the run begins with."""
        return int(self.windows.index[0])

    @property
    def tube_qps(self) -> CondensedQp:
        """The condensed tube-MPC, window by window, numpy float64."""
        return self.condensed.with_tube

    @property
    def plain_qps(self) -> CondensedQp:
        """The condensed MPC without tube and terminal set."""
        return self.condensed.without_tube

    @property
    def solver_slack(self) -> float:
        """By how much an accepted answer of the solver may miss a constraint of the tube-MPC, from
        any error in E, in the units of E and U."""
        return condense.bound_solver_slack(self.problem, self.tube_qps)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the numbers of the tube-MPC, by their place in the condensed QPs."""
        leaves, _ = jax.tree_util.tree_flatten_with_path(self.tube_qps)
        return {jax.tree_util.keystr(place): np.asarray(value) for place, value in leaves}

    def plot(self, name: str = "") -> Figure:
        """Draw the limits, the terminal set and the last section of the tube; return the figure."""
        from jaxtube.figures.sets import design_sets

        return design_sets(self, name)

    def save(self, folder: str | Path) -> Path:
        """Save the design in a folder, for `jaxtube.read`, in place of a design that was saved
        there; return the folder."""
        facts = {"verdict": self.certificate.verdict}
        return write_result(
            folder, StoredResult("design", self.problem.scenario, facts, self.arrays())
        )

    def __repr__(self) -> str:
        settings = self.problem.scenario.controller
        facets = len(self.terminal.constraint_normals)
        parts = (
            f"tube {settings.tube}, terminal {settings.terminal} of {facets} facets, horizon "
            f"{settings.horizon}, model {settings.model}, input map {settings.input_map}, "
            f"{len(self.windows.schedules)} windows"
        )
        return f"{self.certificate!r}\n{parts}"


def require_design(value: object) -> None:
    """Raise ValueError, one line, for anything but a design."""
    if isinstance(value, Design):
        return
    if isinstance(value, str):
        raise ValueError(f"design = {value!r}: is a name; give jt.design(jt.load({value!r}))")
    raise ValueError(f"design: is {describe_type(value)}; give jt.design(scenario)")
