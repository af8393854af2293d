"""What tuning minimises, as a function of weights and gains: laps on the device, reverse mode
through all of them.

    J = mean c + tail_weight CVaR c + tube_weight h_R(lateral) / cap
        + steep costs above the effort limit and margins
    c = sum over errors of (RMS once settled / scale)^2 + (RMS effort / scale)^2     of one lap
    CVaR c  the mean of the worst `tail_share` of the laps,      R  the minimal RPI set's bound

Effort is the speed asked of the wheels less V_r / (1 - i_r), V_l / (1 - i_l) with nominal slips:
what following the reference without errors would ask for.

Source: Rockafellar, Uryasev 2000 (CVaR).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Key

from jaxtube.control.laws import TubeMpc
from jaxtube.control.protocol import Controller, WheelMap
from jaxtube.plant.estimating import EstimatingRobot
from jaxtube.plant.lagging import BareRobot
from jaxtube.qp.batched_ldl import add_up
from jaxtube.qp.regions import AnyArray
from jaxtube.scenario.tree import Scenario
from jaxtube.simulation.rollout import PeriodOutcome
from jaxtube.simulation.usage import add_up_periods
from jaxtube.tuning.caps import CapLimits, shares_of_caps
from jaxtube.tuning.loop import DesignConstants, Weights, condense_windows
from jaxtube.tuning.minimal import ActiveFacets

STEEPNESS = 1e2
"""What the square of a limit's excess costs, as a share of the limit."""


class LapInputs(NamedTuple):
    """What laps run under: the robot, and a key and a start for each lap."""

    plant: BareRobot | EstimatingRobot[BareRobot]
    keys: Key[Array, " laps"]
    starts: Float[Array, "laps 3"]  # tracking errors (m, m, rad)


class LapMeasures(NamedTuple):
    """Laps reduced to what counts; the leading axis is the realisations."""

    errors: Float[AnyArray, "laps 3"]  # RMS once settled (m, m, rad)
    effort: Float[AnyArray, " laps"]  # RMS over the whole lap, m/s
    settled_effort: Float[AnyArray, " laps"]
    excess: Float[AnyArray, " laps"]
    """Mean square of what errors and wheels use beyond the margin of their limits."""
    backups: Float[AnyArray, " laps"]
    """Steps without a plan, whose derivative is zero."""


@partial(
    jax.tree_util.register_dataclass,
    data_fields=[
        "error_costs",
        "effort_cost",
        "effort_limit",
        "tail_weight",
        "tube_weight",
        "margin",
    ],
    meta_fields=["tail_share", "settled"],
)
@dataclass(frozen=True)
class Aim:
    """The objective of a scenario, in SI units: costs are 1 over the square of a scale, 0 where it
    has none."""

    error_costs: tuple[float, float, float]
    effort_cost: float
    effort_limit: float
    tail_share: float
    tail_weight: float
    tube_weight: float
    margin: float
    settled: int  # the step, 1 at least, from which errors count


def make_aim(scenario: Scenario, settled: int) -> Aim:
    """Return the objective of a scenario whose laps have settled from a step on."""
    section = scenario.tuning
    heading = None if section.heading_deg is None else float(np.deg2rad(section.heading_deg))
    error_costs = (
        _inverse_square(section.longitudinal_m),
        _inverse_square(section.lateral_m),
        _inverse_square(heading),
    )
    return Aim(
        error_costs=error_costs,
        effort_cost=_inverse_square(section.effort_mps),
        effort_limit=section.effort_limit_mps or float("inf"),
        tail_share=section.tail_share,
        tail_weight=section.tail_weight,
        tube_weight=section.tube_weight,
        margin=section.margin,
        settled=settled,
    )


def _inverse_square(scale: float | None) -> float:
    return 0.0 if scale is None else 1.0 / scale**2


def measure_laps(
    controller: Controller, lap_inputs: LapInputs, limits: CapLimits, aim: Aim
) -> LapMeasures:
    """Run laps of a controller and reduce each to what counts; differentiable."""
    plant = lap_inputs.plant
    robot = plant.plant if isinstance(plant, EstimatingRobot) else plant
    idle = robot.reference_wheels / (1.0 - robot.slips.nominal)
    steps = len(idle)

    def observe(step, errors: Float[Array, "laps 3"], happened: PeriodOutcome):
        coordinates = jnp.unstack(errors, axis=1)
        wheels = jnp.unstack(happened.demanded, axis=1)
        is_settled = step + 1 >= aim.settled
        squares = [jnp.where(is_settled, error**2, 0.0) for error in coordinates]
        effort = add_up([(wheels[i] - idle[step, i]) ** 2 for i in range(2)]) / 2.0
        shares = [jnp.abs(error) / limits.widths[i] for i, error in enumerate(coordinates)]
        shares += [wheel / robot.robot.wheel_speed_max for wheel in wheels]
        return {
            "longitudinal": squares[0],
            "lateral": squares[1],
            "heading": squares[2],
            "effort": effort,
            "settled_effort": jnp.where(is_settled, effort, 0.0),
            "excess": add_up([jnp.maximum(share - aim.margin, 0.0) ** 2 for share in shares]),
            "backups": happened.diagnostics.backup.astype(effort.dtype),
        }

    sums = add_up_periods(controller, plant, lap_inputs.keys, lap_inputs.starts, observe)
    errors = jnp.stack([sums[name] for name in ("longitudinal", "lateral", "heading")], axis=1)
    settled_steps = steps - aim.settled + 1
    return LapMeasures(
        errors=_root(errors / settled_steps),
        effort=_root(sums["effort"] / steps),
        settled_effort=_root(sums["settled_effort"] / settled_steps),
        excess=sums["excess"] / steps,
        backups=sums["backups"],
    )


def _root(squares: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return roots whose derivative at 0 is finite."""
    return jnp.sqrt(jnp.maximum(squares, 1e-24))


def lap_costs(laps: LapMeasures, aim: Aim) -> Float[Array, " laps"]:
    """Return c of every lap."""
    return laps.errors**2 @ jnp.array(aim.error_costs) + aim.effort_cost * laps.effort**2


def total_cost(laps: LapMeasures, shares: Float[Array, " caps"], aim: Aim) -> Float[Array, ""]:
    """Return J of laps and of the shares of the caps that the tube fills (longitudinal, lateral,
    heading, ..)."""
    costs = lap_costs(laps, aim)
    worst = jax.lax.top_k(costs, max(1, round(aim.tail_share * len(costs))))[0]
    effort = _root(jnp.mean(laps.effort**2))
    excess = jnp.maximum(effort / aim.effort_limit - 1.0, 0.0) ** 2 + jnp.mean(laps.excess)
    excess = excess + jnp.sum(jnp.maximum(shares - aim.margin, 0.0) ** 2)
    return (
        jnp.mean(costs)
        + aim.tail_weight * jnp.mean(worst)
        + aim.tube_weight * shares[1]
        + STEEPNESS * excess
    )


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["design", "active", "wheel_map"],
    meta_fields=["restart"],
)
@dataclass(frozen=True)
class EvaluationConstants:
    """All that an evaluation holds fixed: the design, what attains the widest tube, and the
    controller's two choices."""

    design: DesignConstants
    active: ActiveFacets
    wheel_map: WheelMap
    restart: bool

    def controller(self, weights: Weights) -> TubeMpc:
        """Return the tube-MPC with these weights and gains; differentiable in them."""
        windows = condense_windows(self.design, weights)
        return TubeMpc(windows, jnp.asarray(self.design.index), self.wheel_map, self.restart)

    def tube_shares(self, kappa: Float[Array, " kappa"]) -> Float[Array, " caps"]:
        """Return the share of each cap that the tube fills at its widest."""
        loops = self.design.maps.vertex_loops.at(kappa)
        gains = self.design.maps.corner_gains.at(kappa)
        return shares_of_caps(self.active, self.design.limits, loops, self.design.generators, gains)


def run_tube_mpc(
    weights: Weights, constants: EvaluationConstants, lap_inputs: LapInputs, aim: Aim
) -> LapMeasures:
    """Return the laps of the tube-MPC with these weights and gains; differentiable in them."""
    return measure_laps(constants.controller(weights), lap_inputs, constants.design.limits, aim)


def objective(
    weights: Weights, constants: EvaluationConstants, lap_inputs: LapInputs, aim: Aim
) -> Float[Array, ""]:
    """Return J of the tube-MPC with these weights and gains; differentiable in them.

    Where slips jump with the robot's place (`patches`, `adversarial`) the derivative is that
    between the jumps.
    """
    laps = run_tube_mpc(weights, constants, lap_inputs, aim)
    return total_cost(laps, constants.tube_shares(weights.kappa), aim)
