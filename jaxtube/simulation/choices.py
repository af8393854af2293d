"""Controllers, plants and starts of a closed loop by their names, or of a user's own."""

from __future__ import annotations

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxtube.control.own import Sizes, adapt_controller
from jaxtube.control.protocol import Controller, DirectInputs
from jaxtube.plant.protocol import Plant
from jaxtube.plant.slip import SlipProcess
from jaxtube.simulation import components
from jaxtube.simulation.starts import FixedStart, Starts, uniform_start
from jaxtube.synthesis.feasible import true_starts
from jaxtube.synthesis.parts import Design, LinearDesign
from jaxtube.systems.system import LinearSystem

ControllerChoice = str | Controller | Callable[..., Float[Array, "batch 2"]]
PlantChoice = str | Plant | LinearSystem
SlipChoice = str | SlipProcess | None
StartChoice = str | Float[np.ndarray, "laps 3"]


def choose_controller(
    design: Design | LinearDesign, controller: ControllerChoice, starts: Starts | None = None
) -> Controller:
    """Return the controller of a name, or what a closed loop can run of a user's own; `starts` as
    for `components.make_tube_mpc`."""
    if isinstance(design, LinearDesign):
        if isinstance(controller, str):
            return components.make_linear_controller(design, controller)
        system = design.system
        sizes = Sizes(system.states, system.inputs, len(system.A), "th, the weights of vertices,")
        return adapt_controller(controller, DirectInputs(), sizes)
    if not isinstance(controller, str):
        return adapt_controller(controller, components.make_wheel_map(design.problem))
    makers = components.controller_makers(design, starts)
    if controller not in makers:
        raise ValueError(f"controller = {controller!r}: is unknown; choose one of {list(makers)}")
    return makers[controller]()


def choose_plant(
    design: Design | LinearDesign, plant: PlantChoice, slip: SlipChoice = None
) -> Plant:
    """Return the plant of a name, or a user's own; `slip` for the robot alone."""
    if isinstance(plant, LinearSystem):
        if isinstance(design, LinearDesign):
            return components.plant_of_system(design, plant)
        raise ValueError('plant: is a LinearSystem, which is no robot; choose "linear"')
    if not isinstance(plant, str):
        return plant
    if isinstance(design, LinearDesign):
        return _choose_linear_plant(design, plant, slip)
    if plant == "robot":
        return components.slipping_robot(design, slip)
    if slip is not None:
        raise ValueError(f'slip = {slip!r}: plant = {plant!r} draws no slips; choose "robot"')
    if plant == "exact":
        return components.exact_robot(design)
    if plant == "linear":
        return components.linear_plant(design)
    raise ValueError(f'plant = {plant!r}: is unknown; choose "robot", "exact" or "linear"')


def _choose_linear_plant(design: LinearDesign, plant: str, slip: SlipChoice) -> Plant:
    """Return the plant of a linear system by its name."""
    refuse_slip(slip)
    if plant == "linear":
        return components.linear_plant(design)
    if plant == "motion":
        return components.own_motion(design.problem)
    raise ValueError(f'plant = {plant!r}: is unknown; choose "linear" or "motion"')


def refuse_slip(slip: SlipChoice) -> None:
    """Raise ValueError, one line, for a slip process of a system without slips."""
    if slip is not None:
        raise ValueError(f"slip = {slip!r}: a linear system has no slips; leave it out")


def find_plant(design: Design | LinearDesign, plant: PlantChoice | None) -> PlantChoice:
    """Return a plant, or the name of the one that a design is run on unless told: the robot of a
    scenario, the motion of a linear system, and without one its model."""
    if plant is not None:
        return plant
    if isinstance(design, LinearDesign):
        return "linear" if design.system.motion is None else "motion"
    return "robot"


def choose_starts(design: Design | LinearDesign, starts: str) -> Starts:
    """Return the law of initial errors: the scenario's start, or uniform in the feasible set of the
    tube-MPC, or on its edge.

    Raises:
        ValueError: for an unknown name, or where no start has a plan.
    """
    if not isinstance(starts, str):
        raise ValueError("starts: is no name; only jt.simulate takes initial errors one by one")
    if starts == "scenario":
        return FixedStart(jnp.asarray(design.problem.initial_error))
    if starts not in ("feasible", "edge"):
        raise ValueError(
            f'starts = {starts!r}: is unknown; choose "scenario", "feasible" or "edge"'
        )
    # The seed of the set's shape is fixed: the law of the starts is the scenario's alone.
    points = true_starts(design.tube_qps, design.first_window, design.problem, seed=0)
    return uniform_start(points, edge=starts == "edge")


def name_choice(choice: object) -> str:
    """Return the name of what was chosen, "own" for a user's own."""
    return choice if isinstance(choice, str) else "own"


def name_controller(controller: ControllerChoice) -> str:
    """Return what Python calls a controller: its name, that of its function, or that of its class;
    "own" for a lambda."""
    if isinstance(controller, str):
        return controller
    name = getattr(controller, "__name__", type(controller).__name__)
    return "own" if name == "<lambda>" else name
