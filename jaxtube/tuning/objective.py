"""What tuning minimises, as a function of weights and gains: laps on the device, reverse mode
through all of them.

    J = mean c + tail_weight CVaR c + tube_weight h_R(lateral) / cap + steep costs above the effort limit and margins
    c = sum over errors of (RMS once settled / scale)^2 + (RMS effort / scale)^2        of one lap
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
from jaxtyping import Float

from jaxtube.control.laws import TubeMpc
from jaxtube.control.mpc import AnyArray
from jaxtube.control.protocol import WheelMap
from jaxtube.plant.slipping import SlippingRobot
from jaxtube.scenario import Scenario
from jaxtube.simulation.usage import play
from jaxtube.tuning.loop import Fixed, Weights, windows_of
from jaxtube.tuning.minimal import ActiveFacets, Limits, cap_shares

STEEPNESS = 1e2
"""What the square of a limit's excess costs, as a share of the limit."""


class Laps(NamedTuple):
    """What laps come to; the leading axis is the realisations."""

    errors: Float[AnyArray, "laps 3"]  # RMS once settled (m, m, rad)
    effort: Float[AnyArray, " laps"]  # RMS over the whole lap, m/s
    settled_effort: Float[AnyArray, " laps"]
    excess: Float[
        AnyArray, " laps"
    ]  # mean square of what errors and wheels use beyond the margin of their limits
    backups: Float[AnyArray, " laps"]  # steps without a plan, whose derivative is zero


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


def aim(scenario: Scenario, settled: int) -> Aim:
    """Return the objective of a scenario whose laps have settled from a step on."""
    section = scenario.tuning
    heading = None if section.heading_deg is None else float(np.deg2rad(section.heading_deg))
    scales = section.longitudinal_m, section.lateral_m, heading, section.effort_mps
    along, across, turned, effort = (0.0 if scale is None else 1.0 / scale**2 for scale in scales)
    limit = section.effort_limit_mps or float("inf")
    tail = section.tail_share, section.tail_weight
    return Aim(
        (along, across, turned), effort, limit, *tail, section.tube_weight, section.margin, settled
    )


def run_laps(
    controller, plant: SlippingRobot, keys, starts: Float[Array, "laps 3"], limits: Limits, aim: Aim
) -> Laps:
    """Run laps of a controller and reduce each to what counts; differentiable."""
    seen = play(controller, plant, keys, starts)
    idle = plant.reference_wheels / (1.0 - plant.nominal_slip)
    effort = jnp.sum((seen["wheels"] - idle[:, None]) ** 2, axis=2) / 2.0
    errors = jnp.mean(
        seen["error"][aim.settled - 1 :] ** 2, axis=0
    )  # what is seen first comes after a period
    robot = plant.robot
    of_errors = jnp.maximum(jnp.abs(seen["error"]) / limits.widths - aim.margin, 0.0)
    of_wheels = jnp.maximum(seen["wheels"] / robot.wheel_speed_max - aim.margin, 0.0)
    excess = jnp.sum(of_errors**2, axis=2) + jnp.sum(of_wheels**2, axis=2)
    backups = jnp.sum(seen["backup"], axis=0).astype(errors.dtype)
    settled_effort = _root(jnp.mean(effort[aim.settled - 1 :], axis=0))
    return Laps(
        _root(errors),
        _root(jnp.mean(effort, axis=0)),
        settled_effort,
        jnp.mean(excess, axis=0),
        backups,
    )


def _root(squares: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return roots whose derivative at 0 is finite."""
    return jnp.sqrt(jnp.maximum(squares, 1e-24))


def lap_costs(laps: Laps, aim: Aim) -> Float[Array, " laps"]:
    """Return c of every lap."""
    return laps.errors**2 @ jnp.array(aim.error_costs) + aim.effort_cost * laps.effort**2


def total_cost(laps: Laps, shares: Float[Array, " caps"], aim: Aim) -> Float[Array, ""]:
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


class Frozen(NamedTuple):
    """All that an evaluation holds fixed: the design, what attains the widest tube, and its limits."""

    fixed: Fixed
    active: ActiveFacets
    limits: Limits


def tube_shares(frozen: Frozen, kappa: Float[Array, " kappa"]) -> Float[Array, " caps"]:
    """Return the share of each cap that the tube fills at its widest."""
    fixed, maps = frozen.fixed, frozen.fixed.maps
    loops, gains = maps.vertex_loops.at(kappa), maps.corner_gains.at(kappa)
    return cap_shares(frozen.active, frozen.limits, loops, fixed.generators, gains)


def controller_laps(
    weights: Weights,
    frozen: Frozen,
    plant,
    keys,
    starts,
    aim: Aim,
    wheel_map: WheelMap,
    restart: bool,
) -> Laps:
    """Return the laps of the tube-MPC with these weights and gains; differentiable in them."""
    controller = TubeMpc(
        windows_of(frozen.fixed, weights), jnp.asarray(frozen.fixed.index), wheel_map, restart
    )
    return run_laps(controller, plant, keys, starts, frozen.limits, aim)


def objective(
    weights: Weights,
    frozen: Frozen,
    plant,
    keys,
    starts,
    aim: Aim,
    wheel_map: WheelMap,
    restart: bool,
) -> Float[Array, ""]:
    """Return J of the tube-MPC with these weights and gains; differentiable in them.

    Where slips jump with the robot's place (`patches`, `adversarial`) the derivative is that
    between the jumps.
    """
    laps = controller_laps(weights, frozen, plant, keys, starts, aim, wheel_map, restart)
    return total_cost(laps, tube_shares(frozen, weights.kappa), aim)
