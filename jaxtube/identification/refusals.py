"""What windows cannot tell, each in one line with the cure.

Source: new; the form of a line is that of `jaxtube.scenario.refusal`.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool, Float

from jaxtube.identification.box import Box
from jaxtube.identification.geometry import Geometry
from jaxtube.identification.promise import Promise, make_promise
from jaxtube.recordings.windows import Windows
from jaxtube.scenario.refusal import ScenarioError, refusal

LEAST_PROMISE = 0.1
"""A smaller one says nothing."""

USUAL_PROMISE = 0.8
"""That a user is told the number of commands for."""

MOST_LOST = 0.8
"""Share of lost windows beyond which a log tells nothing."""

FEWEST_FITTED = 3
"""Commands that track and lever arm are fitted to."""

PARTS = 3
"""Commands are dealt to: one part fits track and lever arm, the others count."""

LEAST_TURNING = 0.05
"""Of |v_r - v_l| / (v_r + v_l), in one of four windows at least."""

LEAST_EXPLAINED_BY_TRACK = 0.5
"""Of the yaw rate, by the wheels through an effective track."""

MOST_ROLLED = 2.0
"""Times that wheels may roll as far as the poses move, or the other way round."""

MOST_SPREAD = 0.8
"""Width of an interval of slip."""

MOST_TRACK_ERROR = 0.1
"""Standard error of the track, relative."""


def refuse_lost(windows: Windows) -> None:
    """Refuse windows whose pose is lost nearly everywhere."""
    share = float(np.mean(windows.lost))
    if share > MOST_LOST:
        problem = "is the share of windows in which the pose is lost"
        cure = "record with a pose that holds, or cut the log to where it does"
        raise refusal(windows.path, "lost", round(share, 3), problem, cure)


def few_commands(
    windows: Windows, forwards: Bool[np.ndarray, "k"], least: float, promise: Promise
) -> ScenarioError:
    """Return the refusal of windows with too few commands that drive both wheels forwards."""
    commands = len(np.unique(windows.command[forwards]))
    others = len(np.unique(windows.command[windows.steady & ~windows.lost]))
    more = math.ceil(1.5 * promise.count_needed(USUAL_PROMISE))
    problem = (
        f"of {others} steady ones drive both wheels forwards at {least:.3g} m/s and more: "
        f"from {promise.commands} of them, beside those for the track, "
        f"{100 * promise.share:.0f} % of new commands could be promised"
    )
    cure = f"record {more} such commands for {100 * USUAL_PROMISE:.0f} %"
    rolling = windows.steady & ~windows.lost & (windows.wheels.min(axis=1) > 0.0)
    most = len(np.unique(windows.command[rolling]))
    counted = most - math.ceil(most / PARTS)
    if most - counted >= FEWEST_FITTED and make_promise(counted, 1).share >= LEAST_PROMISE:
        cure += ", or lower --least-wheel-mps, or choose a --box of fewer sides"
    else:
        cure += f"; no option makes this log enough, {most} drive both wheels forwards at all"
    return refusal(windows.path, "commands", commands, problem, cure)


def refuse_straight(windows: Windows, fits: Bool[np.ndarray, "k"]) -> None:
    """Refuse commands that hardly turn."""
    wheels = windows.wheels[fits]
    turning = np.abs(wheels[:, 0] - wheels[:, 1]) / wheels.sum(axis=1)
    strong = float(np.percentile(turning, 75.0))
    if strong < LEAST_TURNING:
        problem = "is how far wheels differ, by their sum: no track can be told from straight lines"
        cure = "drive curves both ways, one wheel at half of the other's speed and less"
        raise refusal(windows.path, "turning", round(strong, 4), problem, cure)


def refuse_other_turning(windows: Windows, geometry: Geometry) -> None:
    """Refuse a robot that an effective track does not describe."""
    if geometry.explained >= LEAST_EXPLAINED_BY_TRACK:
        return
    problem = (
        "is the share of the yaw rate that wheels explain through an effective track: this robot "
        "turns by something else, such as sliding"
    )
    cure = "record on firmer ground or slower"
    share = round(max(geometry.explained, 0.0), 3)
    raise refusal(windows.path, "explained", share, problem, cure)


def refuse_vague_track(windows: Windows, geometry: Geometry) -> None:
    """Refuse an effective track that is not sure enough."""
    error = geometry.track_error / geometry.track
    if error > MOST_TRACK_ERROR:
        problem = (
            f"is the relative standard error of the effective track, {geometry.track:.3g} m: "
            "too large to count on"
        )
        cure = "record more commands with curves both ways"
        raise refusal(windows.path, "track error", round(error, 3), problem, cure)


def refuse_units(windows: Windows, slips: Float[np.ndarray, "k 2"]) -> None:
    """Refuse slips, of the windows that count, that wheels in other units make."""
    rolled = 1.0 / max(1.0 - float(np.median(slips)), 1e-3)
    if not 1.0 / MOST_ROLLED <= rolled <= MOST_ROLLED:
        problem = "is how far the wheels roll, by how far the poses move: no ground slips so much"
        cure = (
            "name what the wheel speeds are in, such as --units left=rad/s,right=rad/s with "
            "--wheel-radius"
        )
        raise refusal(windows.path, "wheels", round(rolled, 3), problem, cure)


def refuse_box(windows: Windows, box: Box) -> None:
    """Refuse slips of one and more, which no wheel speed makes up for, as much sideslip, and slips
    that tell of a pose that does not hold."""
    for name, values in (("slip.right", box.right), ("slip.left", box.left)):
        greatest = max(values, key=abs)
        if abs(greatest) >= 1.0:
            problem = (
                "is the greatest one: the ground runs against the wheel, and no wheel speed makes "
                "up for that"
            )
            cure = "record on firmer ground or with a steadier pose, or raise --least-wheel-mps"
            raise refusal(windows.path, name, round(greatest, 3), problem, cure)
        spread = values[1] - values[0]
        if spread > MOST_SPREAD:
            problem = "is how far slips lie apart: that is the pose rather than the ground"
            cure = "record with a pose that holds, or raise --window-s or --least-wheel-mps"
            raise refusal(windows.path, name, round(spread, 3), problem, cure)
    if box.sideslip >= 1.0:
        problem = "is the greatest one, by forward speed: the robot slides rather than drives"
        cure = "record on firmer ground or with a steadier pose, or raise --least-wheel-mps"
        raise refusal(windows.path, "slip.sideslip", round(box.sideslip, 3), problem, cure)
