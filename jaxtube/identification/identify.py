"""From windows of a log to track, lever arm, slips, sideslip, and what the sample promises of them.

    1. windows that are steady, not lost, and drive both wheels forwards fast enough
    2. every third command of these, in order of time: fit effective track and lever arm
    3. the others: slips and sideslip of every window, their extremes are the box
    4. the promise: the scenario bound for the sides of the box and the commands of step 3

The commands of step 3 had no part in step 2, so that given the track they are as new as any. A
command counts once, whatever its windows: it is inside where all of them are.

Source: new; the bound is that of `jaxtube.identification.promise`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxtube.identification import refusals
from jaxtube.identification.box import SIDES, Box, BoxKind, blow_up, enclose, make_alike
from jaxtube.identification.findings import Findings
from jaxtube.identification.geometry import Geometry, find_sideslip, find_slips, fit_geometry
from jaxtube.identification.promise import Promise, make_promise
from jaxtube.identification.windows import find_fastest
from jaxtube.recordings.windows import Windows

SLOWEST_SHARE = 0.25
"""Of the fastest wheel speed, that both wheels must reach by default: of a slower one, slip is a
quotient of small numbers."""

SLOWEST_MPS = 1e-3
"""Below which no wheel drives, whatever the user asks for."""


@dataclass(frozen=True)
class Choices:
    """What the user decides before looking.

    Attributes:
        least_wheel: speed that both wheels must reach, m/s; None for a quarter of the fastest.
        box: its kind; each has another number of sides.
        margin: slip by which the intervals are widened; not promised.
    """

    least_wheel: float | None = None
    box: BoxKind = "each"
    margin: float = 0.0


@dataclass(frozen=True, eq=False)
class Identified:
    """What was identified of a robot.

    Attributes:
        windows: all of them, used or not.
        choices: made before looking.
        least_wheel: speed that both wheels of a used window reach, m/s.
        fastest_wheel: greatest wheel speed of the used windows, m/s.
        fits: windows that track and lever arm were fitted to.
        counts: windows that the box encloses.
        geometry: effective track and lever arm.
        slips: of each window (right, left), shares of the wheel speeds; meaningless where it is
            lost or does not drive forwards.
        sideslips: of each window, lateral by forward speed in the robot's frame, left positive;
            meaningless where the slips are.
        slip_noise: standard deviation of a slip by pose noise, median of the windows of `counts`;
            None where the noise is not known.
        box: smallest around the windows of `counts`, without the margin.
        promise: of the box.
    """

    windows: Windows
    choices: Choices
    least_wheel: float
    fastest_wheel: float
    fits: Bool[np.ndarray, "k"]
    counts: Bool[np.ndarray, "k"]
    geometry: Geometry
    slips: Float[np.ndarray, "k 2"]
    sideslips: Float[np.ndarray, "k"]
    slip_noise: float | None
    box: Box
    promise: Promise

    @property
    def widened_box(self) -> Box:
        """The box with the margin, which is not promised."""
        return self.box.widen(self.choices.margin)


class _Sample(NamedTuple):
    """Which windows are used, and for what."""

    least_wheel: float
    fits: Bool[np.ndarray, "k"]
    counts: Bool[np.ndarray, "k"]
    promise: Promise


def identify_log(findings: Findings, choices: Choices) -> Identified:
    """Identify a robot from the windows of its log; see `identify_windows`."""
    noise = findings.noise
    if noise is None:
        return identify_windows(findings.windows.windows, choices)
    place, turn = noise.deviation
    spread = findings.windows.spread * np.array([place, turn, place])
    return identify_windows(findings.windows.windows, choices, spread)


def identify_windows(
    windows: Windows, choices: Choices, spread: Float[np.ndarray, "k 3"] | None = None
) -> Identified:
    """Identify a robot from its windows.

    Args:
        windows: of one robot on one ground.
        choices: made before looking.
        spread: standard deviations of (v, omega, v_y) by pose noise; NaN where the pose was lost;
            None where it is not known.

    Raises:
        ScenarioError: in one line with the cure, for windows that tell nothing: too few that drive
            forwards, no turns, an effective track that does not describe the robot, slips of one
            and more, or a promise of next to nothing.
    """
    sample = _take_sample(windows, choices)
    known = np.zeros_like(windows.velocity) if spread is None else spread
    geometry = _fit_sample(windows, sample, known)
    slips, sideslips = _find_all_slips(windows, geometry)
    box = _make_box(choices.box, slips, sideslips, sample.fits, sample.counts)
    refusals.refuse_units(windows, slips[sample.counts])
    refusals.refuse_box(windows, box.widen(choices.margin))
    noise = None
    if spread is not None:
        noise = _find_slip_noise(windows, geometry, spread, sample.counts)
    return Identified(
        windows=windows,
        choices=choices,
        least_wheel=sample.least_wheel,
        fastest_wheel=float(windows.wheels[sample.fits | sample.counts].max()),
        fits=sample.fits,
        counts=sample.counts,
        geometry=geometry,
        slips=slips,
        sideslips=sideslips,
        slip_noise=noise,
        box=box,
        promise=sample.promise,
    )


def _take_sample(windows: Windows, choices: Choices) -> _Sample:
    """Choose the windows that drive both wheels forwards, and deal their commands."""
    refusals.refuse_lost(windows)
    usable = windows.steady & ~windows.lost
    fastest = find_fastest(windows.wheels[usable])
    least = SLOWEST_SHARE * fastest if choices.least_wheel is None else choices.least_wheel
    forwards = usable & (windows.wheels.min(axis=1) >= max(least, SLOWEST_MPS))
    fits, counts = _deal(windows.command, forwards)
    promise = make_promise(len(np.unique(windows.command[counts])), SIDES[choices.box])
    return _Sample(least, fits, counts, promise)


def _fit_sample(windows: Windows, sample: _Sample, spread: Float[np.ndarray, "k 3"]) -> Geometry:
    """Fit track and lever arm; refuse a sample that does not tell them, or promises nothing."""
    fits = sample.fits
    few = refusals.few_commands(windows, fits | sample.counts, sample.least_wheel, sample.promise)
    if len(np.unique(windows.command[fits])) < refusals.FEWEST_FITTED:
        raise few
    refusals.refuse_straight(windows, fits)
    geometry = fit_geometry(
        windows.wheels[fits], windows.velocity[fits], spread[fits], windows.command[fits]
    )
    refusals.refuse_other_turning(windows, geometry)
    if sample.promise.share < refusals.LEAST_PROMISE:
        raise few
    refusals.refuse_vague_track(windows, geometry)
    return geometry


def _find_all_slips(
    windows: Windows, geometry: Geometry
) -> tuple[Float[np.ndarray, "k 2"], Float[np.ndarray, "k"]]:
    """Return slips and sideslip of all windows, also of those where they mean nothing."""
    with np.errstate(divide="ignore", invalid="ignore"):
        slips = find_slips(windows.wheels, windows.velocity, geometry.track)
        return slips, find_sideslip(windows.velocity, geometry.lever_arm)


def _find_slip_noise(
    windows: Windows,
    geometry: Geometry,
    spread: Float[np.ndarray, "k 3"],
    counts: Bool[np.ndarray, "k"],
) -> float:
    """Return the standard deviation of a slip by pose noise, median of the windows that count."""
    ground = np.hypot(spread[counts, :1], geometry.track * spread[counts, 1:2] / 2.0)
    return float(np.median(ground / windows.wheels[counts]))


def _make_box(
    kind: BoxKind,
    slips: Float[np.ndarray, "k 2"],
    sideslips: Float[np.ndarray, "k"],
    fits: Bool[np.ndarray, "k"],
    counts: Bool[np.ndarray, "k"],
) -> Box:
    """Return the box of a kind around the windows that count."""
    if kind == "scaled":
        return blow_up(enclose(slips[fits], sideslips[fits]), slips[counts], sideslips[counts])
    box = enclose(slips[counts], sideslips[counts])
    return make_alike(box) if kind == "alike" else box


def _deal(
    command: Int[np.ndarray, "k"], used: Bool[np.ndarray, "k"]
) -> tuple[Bool[np.ndarray, "k"], Bool[np.ndarray, "k"]]:
    """Deal the commands of used windows into those that fit and those that count."""
    names = np.unique(command[used])
    fits = used & np.isin(command, names[:: refusals.PARTS])
    return fits, used & ~fits
