"""What simulated laps saw of w(k) in W: evidence beside the certificate, which it never changes."""

from __future__ import annotations

from jaxtube.experiments.run.table import wrap
from jaxtube.synthesis.parts import Design


def disturbance_line(design: Design, disturbance: dict, controller: str) -> str:
    """Return in words how often and how far w left W in simulated steps of a loop.

    A W that was computed and is left is refuted, whatever the certificate says.
    """
    steps = disturbance["steps"]
    if disturbance["margin"] >= 0:
        return (
            f"seen in simulation: in {steps} steps of {controller} no w left W: not refuted, which "
            "proves nothing"
        )
    parts = []
    for name, outside in disturbance["share_of_steps_outside_by_coordinate"].items():
        coordinate, unit = name.rsplit("_", 1)
        largest = disturbance["largest"][name]
        allowed = disturbance["allowed"][name]
        parts.append(
            f"{coordinate} {outside:.1%}, up to {largest:.3g} {unit} where W allows {allowed:.3g}"
        )
    share = disturbance["share_of_steps_outside"]
    line = (
        f"seen in simulation: w lies outside W in {share:.1%} of {steps} steps of {controller} "
        f"({'; '.join(parts)})"
    )
    text = "\n".join(wrap(line, "  "))
    if not design.problem.has_computed_bound:
        return text
    return f"REFUTED: the computed W does not hold\n{text}"
