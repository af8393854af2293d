"""README.md of an export: its files, inputs, outputs and statuses, and what is guaranteed."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from jaxtube.exporting.c_source import count_operations
from jaxtube.exporting.proof import Proof, list_margins
from jaxtube.exporting.recording import Recording
from jaxtube.exporting.templating import render
from jaxtube.synthesis.parts import Design


def render_readme(
    design: Design,
    proofs: Mapping[str, Proof | None],
    recording: Recording,
    title: str,
) -> str:
    """Return README.md.

    Args:
        design: of the controller.
        proofs: of its numbers, by precision.
        recording: of the steps that lie beside it.
        title: of the design, for people.
    """
    proof = proofs["float64"]
    assert proof is not None
    constants = proof.constants
    settings = design.problem.scenario.controller
    caps = constants.caps
    of_commands = not design.problem.scenario.robot.obeys_at_once
    acted_on = "; an estimate" if settings.has_observer else ""
    acted_on += (
        "; of the committed pose, to which commands given will take it" if of_commands else ""
    )
    floats = "solves in floats" if proofs["float32"] else "is refused: it would not be as exact"
    needs_slip = ""
    if constants.needs_slip:
        needs_slip = ", which this design is **not** certified for: give slips"
    needs_running = ""
    if constants.remembers_wheels:
        needs_running = (
            " The wheels lag: begin with wheels that run as the reference does (`runs`); from rest "
            "nothing is guaranteed."
        )
    right, left = constants.nominal_slip
    x, y, heading = constants.reference_poses[0]
    return render(
        "README.md.jinja",
        title=" ".join(title.split()),
        steps=len(constants.window),
        dt=constants.dt,
        verdict=design.certificate.verdict,
        proved="; ".join(list_margins(dict(proofs))) + ".",
        operations=f"{count_operations(constants):,}",
        floats=floats,
        recorded=f"{recording.status.size:,}",
        start=f"({x:g} m, {y:g} m, {heading:g} rad)",
        limits=[f"{limit:g}" for limit in constants.wheel_limits],
        slip=f"{right:g} right, {left:g} left",
        acted_on=acted_on,
        caps=f"{caps[0]:.3g} m, {caps[1]:.3g} m, {np.rad2deg(caps[2]):.3g} deg",
        age=f"{constants.most_age:g}",
        jitter=f"{constants.most_jitter:g}",
        horizon=constants.horizon,
        exchanges=constants.most_exchanges,
        is_certified=constants.is_certified,
        needs_slip=needs_slip,
        needs_running=needs_running,
        certified_time=f"{constants.certified_time:g}",
        has_floats=proofs["float32"] is not None,
        assumptions=[assumption.rstrip(".") for assumption in design.certificate.assumptions],
    )
