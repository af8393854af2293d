"""The numbers of an identification, as metrics.json holds them."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxtube.identification.box import Box
from jaxtube.identification.findings import Findings
from jaxtube.identification.identify import Identified
from jaxtube.identification.scenario_text import find_track_width


def measure(
    identified: Identified, findings: Findings | None, track_width: float | None
) -> dict[str, Any]:
    """Return the numbers of an identification."""
    geometry = identified.geometry
    promise = identified.promise
    width, _ = find_track_width(identified, findings, track_width)
    return {
        "promised_share": promise.share,
        "confidence": promise.confidence,
        "commands": promise.commands,
        "sides": promise.sides,
        "commands_for_95_percent": promise.count_needed(0.95),
        "fitted_commands": len(np.unique(identified.windows.command[identified.fits])),
        **_measure_box(identified.widened_box),
        "slip_noise": identified.slip_noise,
        "effective_track_m": geometry.track,
        "effective_track_standard_error_m": geometry.track_error,
        "effective_track_by_track": geometry.track / width,
        "lever_arm_m": geometry.lever_arm,
        "lever_arm_standard_error_m": geometry.lever_arm_error,
        "crab_angle_rad": geometry.crab,
        "yaw_rate_explained": geometry.explained,
        "least_wheel_mps": identified.least_wheel,
        "fastest_wheel_mps": identified.fastest_wheel,
        "log": _measure_log(findings) if findings else None,
    }


def _measure_box(box: Box) -> dict[str, Any]:
    return {"slip_right": box.right, "slip_left": box.left, "sideslip": box.sideslip}


def _measure_log(findings: Findings) -> dict[str, Any]:
    response = findings.response
    noise = findings.noise
    return {
        "poses_behind_wheels_s": findings.clock.offset,
        "poses_behind_wheels_standard_error_s": findings.clock.standard_error,
        "correlation": findings.clock.correlation,
        "wheel_lag_s": response.lag if response else None,
        "wheel_lag_interval_s": response.lag_interval if response else None,
        "command_delay_s": response.delay if response else None,
        "wheel_response_explained": response.explained if response else None,
        "wheel_period_s": findings.wheel_period,
        "pose_period_s": findings.pose_period,
        "held_share": findings.held_share,
        "pose_noise_m": noise.deviation[0] if noise else None,
        "pose_noise_rad": noise.deviation[1] if noise else None,
        "pose_noise_bound_m": noise.bound[0] if noise else None,
        "pose_noise_bound_rad": noise.bound[1] if noise else None,
        "cuts": [cut._asdict() for cut in findings.cuts.cuts],
    }
