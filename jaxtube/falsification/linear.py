"""What is searched of a linear system's closed loop, and what was found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jaxtube.control.laws import planner_of
from jaxtube.falsification.cases import list_worst_first
from jaxtube.falsification.found import WorstCases
from jaxtube.falsification.setting import (
    LoopLimits,
    Setting,
    choose_start_vertices,
    make_input_limit,
    make_tube_limits,
    require_searchable,
)
from jaxtube.falsification.worst import Worst
from jaxtube.simulation.choices import (
    ControllerChoice,
    PlantChoice,
    choose_controller,
    choose_plant,
    name_choice,
    name_controller,
)
from jaxtube.simulation.usage import Limits, make_limit
from jaxtube.synthesis.feasible import shortfall
from jaxtube.synthesis.parts import LinearDesign
from jaxtube.systems.checks import refuse

SHORT = 1e-9
"""What the rows may lack before a start has no plan: the accuracy of the linear programs."""


@dataclass(frozen=True, eq=False, repr=False)
class LinearFalsification(WorstCases[LinearDesign]):
    """The worst cases of a linear system's closed loop.

    Attributes:
        limits: that were searched, and whose they are.
        seed: of every draw.
        rows: by limit, "error" (E), "input" (U) and "tube": the worst case, its search, and drawn
            laps to compare with.
    """

    @property
    def verdict(self) -> str:
        """What was found, in one line."""
        violated = [name for name in list_worst_first(self.rows) if self.rows[name].is_violated]
        if not violated:
            worst = self.worst
            where = self._describe_facet(worst)
            return f"no violation found; smallest margin {worst.margin:.4g}, {where}"
        listed = "; ".join(
            f"{self._describe_facet(self.rows[name].worst)}, by {-self.rows[name].worst.margin:.4g}"
            for name in violated
        )
        return f"violation found: {listed}"

    def _describe_facet(self, worst: Worst) -> str:
        """Return which facet of which limit a worst case is about, in words."""
        place = f"at step {worst.step}"
        if worst.limit == "tube":
            stage = worst.step - worst.when
            return f"of R_{stage} {place}, facet {worst.facet}"
        problem = self.design.problem
        letter = "E" if worst.limit == "error" else "U"
        names = problem.error_names if worst.limit == "error" else problem.input_names
        offsets = self.limits.all[worst.limit].offsets[0]
        is_upper = worst.facet < len(names)
        bound = float(offsets[worst.facet])
        sign = "<=" if is_upper else ">="
        size = bound if is_upper else -bound
        return f"of {letter} {place}, {names[worst.facet % len(names)]} {sign} {size:.4g}"


def make_linear_setting(
    design: LinearDesign,
    controller: ControllerChoice,
    plant: PlantChoice,
    starts: str,
    seed: int,
) -> Setting:
    """Set up what is searched of a linear system; arguments as for `make_setting`.

    Raises:
        ValueError: one line, for an unknown name, a start without a plan, or a plant that is not
            searched.
    """
    problem = design.problem
    if starts == "scenario" and isinstance(controller, str):
        refuse_start_without_plan(design)
    acting = choose_controller(design, controller)
    # Other controllers keep no tube, even where they make plans.
    planner = planner_of(acting) if controller == "tube_mpc" else None
    horizon = problem.horizon
    steps = np.arange(problem.reference.steps - horizon + 1)
    followed = steps[design.tube.shows(design.windows.index[steps])]
    if not len(followed):
        planner = None
    return Setting(
        limits=LoopLimits(
            design,
            name_controller(controller),
            name_choice(plant),
            _make_lap_limits(design),
            {} if planner is None else {"tube": make_tube_limits(design)},
        ),
        controller=acting,
        planner=planner,
        plant=require_searchable(choose_plant(design, plant)),
        plan_steps=np.zeros(1, int) if planner is None else followed,
        starts=choose_start_vertices(design, starts, seed),
    )


def _make_lap_limits(design: LinearDesign) -> Limits:
    """Return E and U."""
    problem = design.problem
    E = problem.error_set
    return {
        "error": make_limit(E.normals, E.offsets),
        "input": make_input_limit(problem.input_rows),
    }


def refuse_start_without_plan(design: LinearDesign) -> None:
    """Raise ScenarioError, one line, where the system's start has no plan."""
    start = design.problem.initial_error
    missing = shortfall(design.tube_qps, design.first_window, start)
    if missing > SHORT:
        raise refuse(
            "start",
            start,
            f"the tube-MPC has no plan from there (constraints short by {missing:.3g})",
            "start nearer to the origin, or lengthen horizon",
        )
