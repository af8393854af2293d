"""One scenario's tuning: designs, values, gradients and held-out results of points, by index of
their draws.

A point is designed on the host (sets, certificate) and then played on the device. Draws i are the
realisations i n .. (i + 1) n - 1 of the seed; those held out, and those of the final comparison,
begin where no draw reaches.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxtube.control.laws import TubeMpc
from jaxtube.plant.slipping import SlippingRobot
from jaxtube.scenario import ScenarioError
from jaxtube.simulation.closed_loop import make_wheel_map
from jaxtube.simulation.rollout import realisation_keys
from jaxtube.synthesis.design import Design, finish, prepare, refuse_infeasible_start
from jaxtube.synthesis.problem import Problem, with_controller
from jaxtube.tuning.loop import fix, windows_of
from jaxtube.tuning.minimal import active_caps, limits
from jaxtube.tuning.objective import (
    Aim,
    Frozen,
    Laps,
    controller_laps,
    objective,
    run_laps,
    total_cost,
    tube_shares,
)
from jaxtube.tuning.parameters import Parameters

HELD_OUT, COMPARED = 2**40, 2**41
"""First realisations of the laps that decide when to stop, and of those that results are reported
for."""
NO_DESIGN = 1e6
"""Objective where there is no design to play: finite, so that a line search turns back."""

Point = Float[np.ndarray, " free"]


@dataclass(frozen=True, eq=False)
class Designed:
    """A point with its ingredients and what an evaluation holds fixed; `reason` says why there are
    none."""

    point: Point
    ingredients: Design | None
    frozen: Frozen | None
    reason: str = ""


@dataclass(frozen=True, eq=False)
class Inspected:
    """Held-out result and certificate of a point."""

    held_out: float
    certified: bool
    failing: tuple[str, ...]
    laps: Laps | None
    shares: Float[np.ndarray, " caps"] | None


def freeze(found: Design) -> Frozen | None:
    """Return what an evaluation holds of a design, None where the tube of its gains is not bounded;
    raises as `fix`."""
    fixed, within, kappa = fix(found), limits(found.problem), jnp.asarray(found.problem.given_gains)
    loops, gains = fixed.maps.vertex_loops.at(kappa), fixed.maps.corner_gains.at(kappa)
    active = active_caps(within, loops, jnp.asarray(fixed.generators), gains)
    return None if active is None else jax.tree.map(jnp.asarray, Frozen(fixed, active, within))


@partial(jax.jit, static_argnames="restart")
def _played(vector, frozen, plant, keys, starts, parameters, aim, wheel_map, restart):
    return controller_laps(
        parameters.weights(vector), frozen, plant, keys, starts, aim, wheel_map, restart
    )


@partial(jax.jit, static_argnames="restart")
def _value_and_gradient(vector, frozen, plant, keys, starts, parameters, aim, wheel_map, restart):
    def of(vector):
        weights = parameters.weights(vector)
        return objective(weights, frozen, plant, keys, starts, aim, wheel_map, restart)

    return jax.value_and_grad(of)(vector)


_laps, _shares = jax.jit(run_laps), jax.jit(tube_shares)


@dataclass(eq=False)
class Tuner:
    """Values, gradients and inspections of points of one scenario."""

    problem: Problem
    plant: SlippingRobot
    parameters: Parameters
    aim: Aim
    laps: int = 128
    held_out: int = 256
    seed: int = 0
    _last: Designed | None = field(default=None, init=False, repr=False)

    def designed(self, point: Point) -> Designed:
        """Return the ingredients of a point; the last ones are kept."""
        if self._last is None or not np.array_equal(self._last.point, point):
            self._last = self._designed(np.array(point, float))
        return self._last

    @np.errstate(
        all="ignore"
    )  # far from any design numbers overflow, and what comes of them is refused
    def _designed(self, point: Point) -> Designed:
        try:
            found = prepare(
                with_controller(
                    self.problem, self.parameters.scenario(self.problem.scenario, point)
                )
            )
            frozen = freeze(found)
        # Refused scenarios, empty sets and linear algebra raise ValueErrors, hulls and solvers the
        # others.
        except (ArithmeticError, RuntimeError, ValueError) as error:
            return Designed(point, None, None, str(error).splitlines()[0])
        return Designed(
            point, found, frozen, "" if frozen else "the tube of the gains is not bounded"
        )

    def keys(self, first: int, count: int):
        """Return the keys of `count` realisations."""
        return realisation_keys(self.seed, first, count)

    def starts(self, count: int):
        """Return the scenario's start, once a lap."""
        return jnp.tile(jnp.asarray(self.problem.initial_error), (count, 1))

    def _arguments(self, first: int):
        settings = self.problem.scenario.controller
        chosen = (
            self.plant,
            self.keys(first, self.laps),
            self.starts(self.laps),
            self.parameters,
            self.aim,
        )
        return *chosen, make_wheel_map(self.problem), settings.restart

    def _batches(self, play: Callable[[int], Any], first: int, count: int):
        """Return play(first), play(first + laps), .. joined and cut to a count: one shape, one
        compilation."""
        batches = [
            jax.tree.map(np.asarray, play(start))
            for start in range(first, first + count, self.laps)
        ]
        return jax.tree.map(lambda *arrays: np.concatenate(arrays)[:count], *batches)

    def evaluate(self, point: Point, draws: int) -> tuple[float, Point]:
        """Return objective and gradient over the draws of an index; NO_DESIGN and 0 where there is
        nothing to play."""
        frozen = self.designed(point).frozen
        if frozen is None:
            return NO_DESIGN, np.zeros_like(point)
        value, gradient = _value_and_gradient(
            jnp.asarray(point), frozen, *self._arguments(draws * self.laps)
        )
        return float(value), np.asarray(gradient)

    def value(self, point: Point, draws: int) -> float:
        """Return the objective alone."""
        played = self.played(point, draws * self.laps, self.laps)
        return NO_DESIGN if played is None else played[0]

    def played(
        self, point: Point, first: int, count: int
    ) -> tuple[float, Laps, Float[np.ndarray, " caps"]] | None:
        """Return objective, laps and the tube's shares of the caps over given draws, None without a
        closed loop."""
        frozen = self.designed(point).frozen
        if frozen is None:
            return None
        shares = np.asarray(
            _shares(frozen, jnp.asarray(self.parameters.weights(jnp.asarray(point)).kappa))
        )
        laps = self._batches(
            lambda at: _played(jnp.asarray(point), frozen, *self._arguments(at)), first, count
        )
        return float(total_cost(laps, jnp.asarray(shares), self.aim)), laps, shares

    def inspect(self, point: Point) -> Inspected:
        """Return held-out value and certificate of a point."""
        return self._judged(point, self.held_out, HELD_OUT)

    def compare(self, point: Point, laps: int) -> Inspected:
        """Return value and certificate over laps that nothing before has seen."""
        return self._judged(point, laps, COMPARED)

    def _judged(self, point: Point, count: int, first: int) -> Inspected:
        designed, played = self.designed(point), self.played(point, first, count)
        if designed.ingredients is None or played is None:
            return Inspected(np.inf, False, (designed.reason,), None, None)
        failing = certificate_lacks(designed.ingredients)
        return Inspected(played[0], not failing, failing, *played[1:])

    def controller(self, point: Point) -> TubeMpc:
        """Return the tube-MPC of a point.

        Raises:
            ValueError: where there is none.
        """
        designed, settings = self.designed(point), self.problem.scenario.controller
        if designed.frozen is None:
            raise ValueError(f"point: has no closed loop ({designed.reason}); choose another")
        fixed, weights = designed.frozen.fixed, self.parameters.weights(jnp.asarray(point))
        windows = jax.jit(windows_of)(fixed, weights)
        return TubeMpc(
            windows, jnp.asarray(fixed.index), make_wheel_map(self.problem), settings.restart
        )

    def drive(self, controller, first: int, count: int) -> Laps:
        """Return laps of any controller over given draws."""
        within = jax.tree.map(jnp.asarray, limits(self.problem))

        def play(at: int) -> Laps:
            return _laps(
                controller,
                self.plant,
                self.keys(at, self.laps),
                self.starts(self.laps),
                within,
                self.aim,
            )

        return self._batches(play, first, count)


def certificate_lacks(found: Design) -> tuple[str, ...]:
    """Return what the certificate of prepared ingredients lacks, itself where it cannot be
    computed."""
    try:
        return failing_conditions(finish(found))
    except (ArithmeticError, RuntimeError, ValueError) as error:
        return (f"certificate_computed ({error})",)


def failing_conditions(design: Design) -> tuple[str, ...]:
    """Return the names of the conditions that a design lacks, the start's plan among them.

    Where W is assumed they are those of the linear model with w in W.
    """
    certificate = design.certificate
    is_assumed = design.problem.disturbance_bound is None
    failing = certificate.failing_for_model if is_assumed else certificate.failing
    try:
        refuse_infeasible_start(design)
    except ScenarioError:
        return *failing, "start_has_a_plan"
    return tuple(failing)
