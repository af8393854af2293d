"""The worst case of each limit in words: what its facet bounds, what the certificate promises, and
the verdict over all of them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxtube.coordinates import COORDINATES
from jaxtube.falsification.sample import SampledExtremes
from jaxtube.falsification.search import WorstCaseSearch
from jaxtube.falsification.setting import LoopLimits
from jaxtube.falsification.worst import Worst
from jaxtube.simulation.usage import Limit, Replay
from jaxtube.synthesis.disturbance import ground_speed_limits
from jaxtube.synthesis.tightening import CAP_NAMES

BEYOND = 1e-9
"""Usage beyond 1 that is rounding."""

ERRORS = tuple((f"{one.name} error", one.to_display, one.unit) for one in COORDINATES)
"""What each error is called, and its unit with the factor into it."""

WHEELS = ("right wheel", "left wheel")
KINDS = {"input": " deficit", "wheels": "", "acceleration": "'s change in a period"}
"""What of a wheel a limit bounds."""
CAPS = tuple(zip(CAP_NAMES, ("m/s", "rad/s", "rad/s", "rad/s"), strict=True))
"""What each pair of rows bounds where U is a box of caps, and its unit; the coupling comes last."""


class Row(NamedTuple):
    """What a search found of one limit.

    Attributes:
        worst: the worst case, of all searches.
        search: the one that aimed at this limit.
        sampled: drawn laps to compare with.
        played: the worst case, played once more on its own.
    """

    worst: Worst
    search: WorstCaseSearch
    sampled: SampledExtremes
    played: Replay

    @property
    def is_violated(self) -> bool:
        """Whether the limit is left by more than rounding."""
        return is_violated(self.worst)


class Facet(NamedTuple):
    """What a worst case comes to on its facet.

    Attributes:
        words: what the facet bounds, and by how much.
        breach: what lies beyond it where the limit is left.
        margin: in the unit; negative beyond the facet.
        unit: of the margin.
    """

    words: str
    breach: str
    margin: float
    unit: str


def is_violated(worst: Worst) -> bool:
    """Tell whether the limit is left by more than rounding."""
    return worst.usage > 1 + BEYOND


def describe_facet(limit: Limit, worst: Worst) -> Facet:
    """Return what the facet of a worst case bounds, and the margin in its unit."""
    if worst.limit == "tube":
        return _describe_section(limit, worst)
    coordinate = worst.facet % (len(limit.offsets[0]) // 2)
    if worst.limit == "error":
        what, factor, unit = ERRORS[coordinate]
    elif worst.limit == "input" and not _is_of_wheel(limit, worst.facet):
        what, unit = CAPS[coordinate]
        factor = 1.0
    else:
        what = f"{WHEELS[coordinate]}{KINDS[worst.limit]}"
        factor = 1.0
        unit = "m/s"
    # Upper bounds come first in a limit, lower ones after them.
    is_upper = worst.facet < len(limit.offsets[0]) // 2
    _, offsets = limit.at_step(worst.step)
    offset = float(offsets[worst.facet]) * factor
    bound = f"{offset if is_upper else -offset:.3g} {unit}"
    return Facet(
        words=f"{what} {'<=' if is_upper else '>='} {bound}",
        breach=f"{what} {'above' if is_upper else 'below'} its limit of {bound}",
        margin=worst.margin * factor,
        unit=unit,
    )


def _is_of_wheel(limit: Limit, facet: int) -> bool:
    """Return whether a row on inputs bounds the deficit of one wheel: it mixes both inputs."""
    return bool(np.all(limit.normals[0, facet, :2]))


def _describe_section(limit: Limit, worst: Worst) -> Facet:
    stage = worst.step - worst.when
    normal = np.asarray(limit.normals[stage - 1, worst.facet])
    place = f"at stage {stage} of the plan of step {worst.when}, facet {worst.facet} of R_{stage}"
    along = np.flatnonzero(np.abs(normal) > 1e-9 * np.max(np.abs(normal)))
    if len(along) == 1:
        coordinate, factor, unit = ERRORS[along[0]]
        breach = f"{coordinate} beyond its section {place},"
        return Facet(f"{coordinate} {place}", breach, worst.margin * factor, unit)
    rounded = " ".join(f"{entry:.2f}" for entry in normal)
    words = f"{place}, normal ({rounded})"
    return Facet(words, f"deviation beyond its section {words},", worst.margin, "m and rad")


def compute_certified_usage(limits: LoopLimits, name: str) -> float:
    """Return the usage of a limit that the certificate lets no lap pass, infinite where it promises
    nothing: to other controllers than the tube-MPC, and on a user's plant."""
    design = limits.design
    asked = design.problem.ground_speeds
    is_covered = limits.controller == "tube_mpc" and limits.plant != "own"
    if asked is None or not design.certificate.holds_for_robot or not is_covered:
        return np.inf
    if name != "wheels":
        return 1.0
    robot = design.problem.robot
    grip = ground_speed_limits(design.problem)[1] / robot.wheel_speed_max
    ends = asked / grip
    return float(np.max(np.abs(ends - robot.wheel_speed_middle)) / robot.wheel_speed_half_range)


def list_worst_first(rows: dict[str, Row]) -> list[str]:
    """Return the limits by their usage, the greatest first."""
    return sorted(rows, key=lambda name: -rows[name].worst.usage)


def say_verdict(limits: LoopLimits, rows: dict[str, Row]) -> str:
    """Return one line: what was found, the worst first."""
    names = list_worst_first(rows)
    violated = [name for name in names if rows[name].is_violated]
    kept = [name for name in names if name not in violated]
    name = names[0]
    worst = rows[name].worst
    facet = describe_facet(limits.all[name], worst)
    if not violated:
        return (
            f"no violation found; smallest margin {facet.margin:.4g} {facet.unit} of the limit "
            f"`{name}` at step {worst.step} ({facet.words})"
        )
    size = f"{-facet.margin:.4g} {facet.unit}"
    line = f"violation found: {facet.breach} by {size} at step {worst.step}"
    if violated[1:]:
        line += f"; also of {', '.join(violated[1:])}"
    if kept:
        line += f"; none found of {', '.join(kept)}"
    return line
