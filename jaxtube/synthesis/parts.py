"""The parts of a design: problem, gains, tubes, terminal set, bounds, controllers, certificate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxtube.arguments import describe_type
from jaxtube.control.planning import CondensedQp
from jaxtube.storage import StoredResult, flatten, nest, write_result
from jaxtube.synthesis import condense
from jaxtube.synthesis.condense import Bounds
from jaxtube.synthesis.gains import Gain
from jaxtube.synthesis.problem import Problem
from jaxtube.synthesis.stored_certificate import list_certificate_facts
from jaxtube.synthesis.stored_qps import list_qp_arrays, read_qp_arrays
from jaxtube.synthesis.terminal import Terminal
from jaxtube.synthesis.tightening import Tightening
from jaxtube.synthesis.tubes import Tube
from jaxtube.synthesis.windows import Windows
from sets.certificate import Certificate
from sets.lmi import TerminalCost
from sets.polytope import Polytope

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


class StoredQps(NamedTuple):
    """The condensed MPC with the tube and without, as they were saved."""

    with_tube: CondensedQp
    without_tube: CondensedQp


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
    condensed: Condensed | StoredQps
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
        """Return the numbers that commands are computed from, by name: the condensed QPs with the
        tube and without, the gains, the windows, the reference, and W, which tells what plans laps
        meet."""
        problem = self.problem
        windows = self.windows
        terminal_gain = self.terminal.gains
        return flatten(
            {
                "tube_qps": list_qp_arrays(self.tube_qps),
                "plain_qps": list_qp_arrays(self.plain_qps),
                "tube_gain": _list_fields(self.tube_gain, "nominal", "vertices"),
                "terminal_gain": _list_fields(terminal_gain, "nominal", "vertices"),
                "windows": _list_fields(windows, "schedules", "index", "loops", "gains", "regimes"),
                "reference": _list_fields(problem.reference, "wheels", "poses"),
                "disturbance_set": _list_fields(problem.disturbance_set, "normals", "offsets"),
            }
        )

    def with_arrays(self, arrays: Mapping[str, np.ndarray]) -> Design:
        """Return the design of the same scenario whose `arrays` are these, to the bit, without a
        certificate.

        Raises:
            KeyError: where one is missing.
        """
        parts = nest(arrays)
        reference = replace(self.problem.reference, **parts["reference"])
        disturbance_set = Polytope(**parts["disturbance_set"])
        gains = replace(self.terminal.gains, **parts["terminal_gain"])
        return replace(
            self,
            problem=replace(self.problem, reference=reference, disturbance_set=disturbance_set),
            tube_gain=replace(self.tube_gain, **parts["tube_gain"]),
            windows=replace(self.windows, **parts["windows"]),
            terminal=replace(self.terminal, gains=gains),
            condensed=StoredQps(
                read_qp_arrays(self.tube_qps, parts["tube_qps"]),
                read_qp_arrays(self.plain_qps, parts["plain_qps"]),
            ),
            certificate=Certificate(),
        )

    def plot(self, name: str = "") -> Figure:
        """Draw the limits, the terminal set and the last section of the tube; return the figure."""
        from jaxtube.figures.sets import design_sets

        return design_sets(self, name)

    def save(self, folder: str | Path) -> Path:
        """Save the design in a folder, for `jaxtube.read`, in place of a design that was saved
        there; return the folder.

        It holds the scenario, copies of the files that the scenario names, all numbers that
        commands are computed from, and the certificate.
        """
        facts = {"certificate": list_certificate_facts(self.certificate)}
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


def _list_fields(part: object, *names: str) -> dict[str, np.ndarray]:
    """Return arrays of a part of the design, by the names of its fields."""
    return {name: getattr(part, name) for name in names}


def require_design(value: object) -> None:
    """Raise ValueError, one line, for anything but a design."""
    if isinstance(value, Design):
        return
    if isinstance(value, str):
        raise ValueError(f"design = {value!r}: is a name; give jt.design(jt.load({value!r}))")
    raise ValueError(f"design: is {describe_type(value)}; give jt.design(scenario)")
