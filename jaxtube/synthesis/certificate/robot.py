"""What a certificate says of the robot itself: its true errors, its disturbances, its wheels, and
what is assumed."""

from __future__ import annotations

import numpy as np

from jaxtube.synthesis.certificate.fill import cap_shares
from jaxtube.synthesis.disturbance import ground_speed_limits
from jaxtube.synthesis.problem import Problem, error_vector
from jaxtube.synthesis.tightening import LocalGain
from sets import certificate as check
from sets.certificate import Certificate
from sets.robot.disturbance import DisturbanceBound


def certify_robot(certificate: Certificate, problem: Problem) -> None:
    """Check that the promise lies in the constraints, and with a computed W that W and the wheels
    keep up with it."""
    room = float(
        np.min(error_vector(problem.scenario.constraints) - problem.error_set.support(np.eye(3)))
    )
    certificate.add(
        "true_error_in_e",
        room + check.ROUNDING,
        "What the controller keeps of the measured error and the pose noise together lie in the error constraints.",
        f"With the pose noise the true error may leave the error constraints by {-room:.3g}.",
    )
    if problem.residual is not None:
        _disturbance(certificate, problem, problem.residual)
    certificate.assumptions = assumptions(problem)


def _disturbance(certificate: Certificate, problem: Problem, bound: DisturbanceBound) -> None:
    """Check that W is as wide as its bound, and that the wheels can do all that may be asked of
    them."""
    W = problem.disturbance_set
    margin = float(np.min(W.offsets - bound.support(W.normals)))
    widths, reached = (
        np.array([bound.yaw, *bound.box]),
        np.array([bound.found_yaw, *bound.found_box]),
    )
    found = np.clip(reached[widths > 0] / widths[widths > 0], 0, 1)
    certificate.add(
        "disturbance_bound_proved",
        margin + check.ROUNDING,
        "W holds every disturbance of the slipping robot over everything certified, proved by interval arithmetic; "
        f"disturbances found reach {found.min():.1%} to {found.max():.1%} of it.",
        f"W is narrower than the proved bound by {-margin:.3g}.",
    )
    (least, greatest), (slowest, fastest) = bound.ground_speeds, ground_speed_limits(problem)
    room = float(min(np.min(fastest - greatest), np.min(least - slowest)))
    certificate.add(
        "wheel_limits",
        room,
        f"Ground speeds of {least.min():.3f} to {greatest.max():.3f} m/s may be asked for; under every slip the wheels "
        f"have {room:.3g} m/s to spare.",
        f"Ground speeds of {least.min():.3f} to {greatest.max():.3f} m/s may be asked for: {-room:.3g} m/s more than "
        "the wheels can do under the greatest slip.",
    )


def widest_tube_fits(certificate: Certificate, problem: Problem, gain: LocalGain) -> None:
    """Say, for information, how much of each cap the tube of the terminal gain fills, and which one
    binds."""
    shares = cap_shares(problem, gain)
    binding = max(shares, key=lambda name: shares[name])
    listed = ", ".join(f"{name} {share:.1%}" for name, share in shares.items())
    certificate.add(
        "widest_tube_fits",
        1 - shares[binding],
        f"The tube of the terminal gain fills at its widest {shares[binding]:.1%} of the {binding}, which "
        f"binds ({listed}).",
        f"The tube of the terminal gain may outgrow the caps; the {binding} binds ({listed}).",
        required=False,
    )


def assumptions(problem: Problem) -> tuple[str, ...]:
    """Return what the guarantee takes for granted, in words."""
    scenario, slip = problem.scenario, problem.scenario.slip
    which = "true and, on its own, measured" if slip.random == "both" else "true or measured"
    speeds = (
        f"wheel speeds between {problem.model.box[0][0]:g} and {problem.model.box[1][0]:g} m/s, in any order"
        if (scenario.reference.certified_for == "box")
        else f"the {len(problem.regions)} pairs of wheel speeds of the path, in any order"
    )
    return (
        f"{which} slip within {slip.relative_error:.0%} of its nominal value "
        f"({slip.nominal_right:g} right, {slip.nominal_left:g} left), in any sequence",
        f"tracking error measured within {scenario.noise.longitudinal_m:g} m, {scenario.noise.lateral_m:g} m, "
        f"{scenario.noise.heading_deg:g} deg in the robot's frame, without delay",
        f"reference of {speeds}"
        + (
            ""
            if scenario.operating.bands
            else f", known {problem.horizon} periods of {problem.model.dt:g} s ahead"
        ),
        "slip, wheel speeds and reference constant over each period; wheels obey at once; no sideways slip",
        "what is promised holds at the ends of periods, with controllers in 64 bits",
        (
            "the first measured error lies in the invariant set"
            if scenario.operating.bands
            else "the first measured error has a plan"
        )
        + (", and no disturbance leaves W" if scenario.disturbance.bound == "assumed" else ""),
    )
