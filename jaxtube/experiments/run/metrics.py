"""The numbers of a design and of its laps: what `metrics.json` holds, plain and with units in the
keys."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from jaxtube import qp
from jaxtube.coordinates import KEYS, TO_DISPLAY
from jaxtube.experiments.run.conditions import WHOLE, condition_metrics
from jaxtube.plant.reference import settled_step
from jaxtube.plant.robot import is_saturated
from jaxtube.simulation.rollout import Trajectory
from jaxtube.synthesis.certificate.fill import cap_shares, ultimate_bound
from jaxtube.synthesis.limits import InputRows, wheel_rows
from jaxtube.synthesis.parts import Design
from sets.polytope import Polytope


def design_metrics(design: Design) -> dict:
    """Return the numbers of the sets, gains and certificate."""
    problem = design.problem
    terminal = design.terminal
    maximal = terminal.maximal.polytope
    invariant = terminal.invariant
    deficits = wheel_rows(problem.robot.track_width)
    least_input = -problem.input_set.support(-deficits)
    largest_input = problem.input_set.support(deficits)
    volumes = {name: sections[-1].polytope().volume() for name, sections in design.tubes.items()}
    numbers = {
        "lqr_gain": design.lqr_gain,
        "tube_half_widths": {name: tube_half_widths(design, name) for name in design.tubes},
        "tube_volume": volumes,
        "input_support": {name: tube_input_support(design, name) for name in design.tubes},
        "input_set_p_q": np.stack([least_input, largest_input], 1),
        "lmi_cost": design.cost.cost,
        "lmi_objective_value": design.cost.value,
        "terminal_gains": terminal.gains.vertices,
        "terminal_half_widths": None if maximal is None else _half_widths(maximal),
        "terminal_facets": None if invariant is None else len(invariant.offsets),
        "terminal_facets_maximal": None if maximal is None else len(maximal.offsets),
        "terminal_volume_share": terminal.volume_share,
        "terminal_constraint_facets": len(terminal.constraint_normals),
        "terminal_fallback": bool(terminal.fallback),
        "certificate": condition_metrics(design.certificate, WHOLE),
        "certified": design.certificate.holds_for_robot,
        "certified_for_model": design.certificate.holds_for_model,
        "assumptions": list(design.certificate.assumptions),
        "design_seconds": design.seconds,
    }
    return numbers if problem.disturbance_bound is None else numbers | _computed(design)


def _computed(design: Design) -> dict:
    """Return the numbers of a computed W, and the share of each cap that the tube fills at its
    widest."""
    bound = design.problem.disturbance_bound
    assert bound is not None
    slowest, fastest = bound.ground_speeds
    box_shares = bound.found_box / np.maximum(bound.box, 1e-300)
    return {
        "disturbance_bound": {
            "yaw_deg": np.rad2deg(bound.yaw),
            "lateral_per_yaw_m_per_rad": bound.lateral_per_yaw,
            **by_coordinate(bound.box * TO_DISPLAY),
            "found_share": [bound.found_yaw / bound.yaw, *box_shares],
            "ground_speed_range_mps": [slowest.min(), fastest.max()],
        },
        "estimate_error": by_coordinate(design.problem.estimate_error * TO_DISPLAY),
        "cap_shares": cap_shares(design.problem, design.terminal.gains),
        "ultimate_bound": _ultimate(design),
    }


def _ultimate(design: Design) -> dict | None:
    """Return half widths that the tube's own gain ends within, None where there are none."""
    try:
        widths = ultimate_bound(design.problem, design.terminal.gains)
    except ValueError:
        return None
    return by_coordinate(widths * TO_DISPLAY)


def by_coordinate(values: Float[np.ndarray, "3"] | list[float]) -> dict[str, float]:
    """Return one number of each coordinate by its key."""
    return dict(zip(KEYS, values, strict=True))


def _half_widths(polytope: Polytope) -> Float[np.ndarray, "3"]:
    """Return the half widths (m, m, deg) of the smallest symmetric box that holds a set."""
    above = polytope.support(np.eye(3))
    below = polytope.support(-np.eye(3))
    return np.maximum(above, below) * TO_DISPLAY


def tube_half_widths(design: Design, name: str) -> Float[np.ndarray, "horizon+1 3"]:
    """Return the half widths (m, m, deg) of R_0 .. R_N; the largest along the reference where the
    tube follows it."""
    return design.tubes[name].half_widths() * TO_DISPLAY


def tube_input_support(design: Design, name: str) -> Float[np.ndarray, " horizon+1"]:
    """Return the largest support number of K R_j along p and q, j = 0..N, over the gains that may
    act, m/s."""
    deficits = wheel_rows(design.problem.robot.track_width)
    rows = InputRows(np.vstack([deficits, -deficits]), np.zeros((4, 3)), np.zeros(4))
    tube = design.tubes[name]
    return np.array([tube.input_support(stage, rows).max() for stage in range(len(tube))])


def controller_metrics(design: Design, trajectory: Trajectory) -> dict:
    """Return the numbers of one controller over its realisations."""
    problem = design.problem
    limits = problem.error_set.offsets[:3]
    errors = np.abs(trajectory.errors)
    # Counted as "not inside", so that NaN is a violation.
    left = ~np.all(errors <= limits, axis=0)
    outside = left.any(axis=1)
    settled = min(settled_step(problem.reference), len(errors) - 1)
    late = errors[settled:]
    status = trajectory.diagnostics.status
    saturated = is_saturated(trajectory.demanded, trajectory.wheels)
    return {
        "realisations": errors.shape[1],
        "violation_share": float(outside.mean()),
        "violating_realisations": int(outside.sum()),
        "violation_share_by_coordinate": by_coordinate(left.mean(axis=0).tolist()),
        "max_error": {
            "whole_run": _spread(errors.max(axis=0)),
            "after_10_s": _spread(late.max(axis=0)),
        },
        "rms_error": {
            "whole_run": _spread(np.sqrt((errors**2).mean(axis=0))),
            "after_10_s": _spread(np.sqrt((late**2).mean(axis=0))),
        },
        "wheel_speed_max_mps": float(np.max(np.abs(trajectory.wheels))),
        "wheel_speed_mean_mps": float(np.mean(trajectory.wheels)),
        "saturated_share": float(np.mean(saturated)),
        "qp_status": {
            "solved": int(np.sum(status == qp.SOLVED)),
            "infeasible": int(np.sum(status == qp.INFEASIBLE)),
            "unsolved": int(np.sum(status == qp.UNSOLVED)),
        },
        "qp_residual_max": float(np.max(trajectory.diagnostics.residual)),
        "active_share": float(np.mean(trajectory.diagnostics.active)),
        "backup_share": float(np.mean(trajectory.diagnostics.backup)),
    }


def _spread(values: Float[np.ndarray, "runs 3"]) -> dict:
    """Return median and 95 % quantile over realisations, and the worst one, by coordinate."""
    shown = values * TO_DISPLAY
    statistics = {
        "median": np.median(shown, axis=0),
        "p95": np.quantile(shown, 0.95, axis=0),
        "worst": shown.max(0),
    }
    return {name: by_coordinate(values.tolist()) for name, values in statistics.items()}


def disturbance_metrics(design: Design, disturbances: Float[np.ndarray, "steps runs 3"]) -> dict:
    """Return how often and how far w(k) leaves W: by coordinate (its half widths) and in all."""
    problem = design.problem
    regimes = problem.period_regimes[: len(disturbances)]
    axes = np.broadcast_to(np.eye(3), (len(regimes), 3, 3))
    widths = problem.disturbances.support(regimes, axes)
    sizes = np.abs(disturbances)
    margins = problem.disturbances.margin(regimes, disturbances)
    # Counted as "not inside", so that NaN is outside.
    beyond_widths = ~(sizes <= widths[:, None])
    outside = ~(margins >= 0)
    return {
        "steps": int(outside.size),
        "share_of_steps_outside": float(outside.mean()),
        "share_of_steps_outside_by_coordinate": by_coordinate(
            beyond_widths.mean(axis=(0, 1)).tolist()
        ),
        "largest": by_coordinate((sizes.max(axis=(0, 1)) * TO_DISPLAY).tolist()),
        "allowed": by_coordinate((widths.max(axis=0) * TO_DISPLAY).tolist()),
        "runs_with_every_w_inside": int(np.sum(~outside.any(axis=0))),
        "margin": float(np.min(margins)),
        "every_w_inside": not outside.any(),
    }


def deviation_metrics(design: Design, deviations: Float[np.ndarray, "horizon samples 3"]) -> dict:
    """Return how many deviations from plans left the tube in use, and the smallest facet margin,
    stage by stage."""
    margins = design.tube.margins(deviations)
    outside = ~(margins >= 0)
    return {
        "plans": margins.shape[1],
        "samples": margins.size,
        "share_outside": float(np.mean(outside)),
        "share_outside_by_stage": np.mean(outside, axis=1),
        "margin_by_stage": margins.min(axis=1),
    }
