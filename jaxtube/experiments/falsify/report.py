"""What `falsify` says of its search: the verdict, the table and the metrics."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxtube.experiments.run.table import Column, format_table, left
from jaxtube.falsification.search import Search, Worst
from jaxtube.falsification.setting import Setting
from jaxtube.plant.reference import TRANSIENT_S
from jaxtube.simulation.usage import Limit, Sampled
from jaxtube.synthesis.disturbance import ground_speed_limits

BEYOND = 1e-9
"""Usage beyond 1 that is rounding."""

ERRORS = (
    ("longitudinal error", 1.0, "m"),
    ("lateral error", 1.0, "m"),
    ("heading error", np.rad2deg(1.0), "deg"),
)
WHEELS = ("right wheel", "left wheel")
CAPS = (("speed deficit", "m/s"), ("yaw rate deficit", "rad/s"))


NOTE = """usage: 1 on the facet, above 1 outside; certified: what no lap can pass. By gradient: laps played with their
derivative. Drawn laps: as many as fit into the time of the search; for limits that one lap answers, into the sum
of their times."""

WIDEST = "Of the tube `sequence` only the plans with the widest window ahead were searched."


class Row(NamedTuple):
    """What came out for one limit."""

    worst: Worst
    search: Search
    sampled: Sampled


def facet(limit: Limit, name: str, worst: Worst) -> tuple[str, float, str]:
    """Return (what the facet bounds, margin in its unit, the unit)."""
    side = len(limit.offsets[0]) // 2
    if name == "error":
        coordinate, factor, unit = ERRORS[worst.facet % side]
        offset = float(limit.offsets[0, worst.facet]) * factor
        bound = f"<= {offset:.3g}" if worst.facet < side else f">= {-offset:.3g}"
        return f"{coordinate} {bound} {unit}", worst.margin * factor, unit
    if name == "tube":
        stage = worst.step - worst.when
        normal = np.asarray(limit.normals[stage - 1, worst.facet])
        place = (
            f"at stage {stage} of the plan of step {worst.when}, facet {worst.facet} of R_{stage}"
        )
        along = np.flatnonzero(np.abs(normal) > 1e-9 * np.max(np.abs(normal)))
        if len(along) == 1:
            coordinate, factor, unit = ERRORS[along[0]]
            return f"{coordinate} {place}", worst.margin * factor, unit
        rounded = " ".join(f"{entry:.2f}" for entry in normal)
        return f"{place}, normal ({rounded})", worst.margin, "m and rad"
    coordinate, offset = worst.facet % side, float(limit.offsets[0, worst.facet])
    bound = f"<= {offset:.3g}" if worst.facet < side else f">= {-offset:.3g}"
    if name == "input" and np.count_nonzero(limit.normals[0, worst.facet]) == 1:
        what, unit = CAPS[coordinate]
        return f"{what} {bound} {unit}", worst.margin, unit
    kind = " deficit" if name == "input" else ""
    return f"{WHEELS[coordinate]}{kind} {bound} m/s", worst.margin, "m/s"


def certified(setting: Setting, name: str) -> float:
    """Return the usage of a limit that the certificate does not let a lap pass, infinite where
    there is none."""
    found = setting.found
    bound = found.problem.disturbance_bound
    if (
        bound is None
        or not found.certificate.holds_for_robot
        or setting.controller_name != "tube_mpc"
    ):
        return np.inf
    if name != "wheels":
        return 1.0
    robot = found.problem.robot
    grip = ground_speed_limits(found.problem)[1] / robot.wheel_speed_max
    ends = bound.ground_speeds / grip
    middle, half = (
        (robot.wheel_speed_max + robot.wheel_speed_min) / 2,
        (robot.wheel_speed_max - robot.wheel_speed_min) / 2,
    )
    return float(np.max(np.abs(ends - middle)) / half)


def violated(worst: Worst) -> bool:
    """Tell whether the limit is left by more than rounding."""
    return worst.usage > 1 + BEYOND


def verdict(setting: Setting, rows: dict[str, Row]) -> str:
    """Return one line: what was found, the worst first."""
    ordered = sorted(rows, key=lambda name: -rows[name].worst.usage)
    left = [name for name in ordered if violated(rows[name].worst)]
    name = ordered[0]
    what, margin, unit = facet(setting.limits(name)[name], name, rows[name].worst)
    place = f"at step {rows[name].worst.step} ({what})"
    if not left:
        return (
            f"no violation found; smallest margin {margin:.4g} {unit} of the limit `{name}` {place}"
        )
    others = f"; also of {', '.join(left[1:])}" if left[1:] else ""
    kept = [name for name in ordered if name not in left]
    kept = f"; none found of {', '.join(kept)}" if kept else ""
    return f"violation found: {name} by {-margin:.4g} {unit} {place}{others}{kept}"


def report(setting: Setting, rows: dict[str, Row]) -> str:
    """Return the verdict and the table."""
    columns = [
        left("limit"),
        Column("by gradient\ncertified"),
        Column("by gradient\nusage"),
        Column("by gradient\nmargin"),
        Column("by gradient\nlaps"),
        Column("by gradient\nseconds"),
        Column("drawn laps\nusage"),
        Column("drawn laps\nlaps"),
        left("where"),
    ]
    body = [_limit_row(setting, name, row) for name, row in rows.items()]
    lines = [verdict(setting, rows), "", format_table(columns, body), "", NOTE]
    if "tube" in rows and setting.found.tube.follows_reference:
        lines.append(WIDEST)
    return "\n".join(lines)


def _limit_row(setting: Setting, name: str, row: Row) -> list[str]:
    what, margin, unit = facet(setting.limits(name)[name], name, row.worst)
    return [
        name,
        _certified_words(setting, name),
        f"{row.worst.usage:.4f}",
        f"{margin:.4g} {unit}",
        f"{row.search.laps:,}",
        f"{row.search.seconds:.1f}",
        f"{row.sampled.usage(name):.4f}",
        f"{row.sampled.laps:,}",
        f"step {row.worst.step}, {what}",
    ]


def _certified_words(setting: Setting, name: str) -> str:
    usage = certified(setting, name)
    return f"<= {usage:.4f}" if np.isfinite(usage) else "nothing"


def metrics(setting: Setting, rows: dict[str, Row]) -> dict:
    """Return the numbers of the search."""
    settled = round(TRANSIENT_S / setting.found.problem.reference.dt)
    found = {}
    for name, row in rows.items():
        what, margin, unit = facet(setting.limits(name)[name], name, row.worst)
        found[name] = {
            "violation": violated(row.worst),
            "facet": what,
            "step": row.worst.step,
            "margin": margin,
            "margin_unit": unit,
            "usage": row.worst.usage,
            "certified_usage": certified(setting, name),
            "seconds": row.search.seconds,
            "laps": row.search.laps,
            "drawn_usage": row.sampled.usage(name),
            "drawn_laps": row.sampled.laps,
            "drawn_seconds": row.sampled.seconds,
        }
        if name != "tube":
            reach = {"": row.search.reach[name], "drawn_": row.sampled.reach[name]}
            found[name] |= {
                f"{which}usage_by_facet": each.max(axis=0) for which, each in reach.items()
            }
            last = {
                which: each[min(settled, len(each) - 1) :].max(axis=0)
                for which, each in reach.items()
            }
            found[name] |= {
                f"{which}usage_by_facet_after_10_s": each for which, each in last.items()
            }
    return {"limits": found, "violation": any(violated(row.worst) for row in rows.values())}
