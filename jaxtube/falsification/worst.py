"""The worst case of one limit, as its replay has it."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from jaxtube.control.protocol import Controller
from jaxtube.plant.protocol import SearchablePlant
from jaxtube.simulation.usage import Limit, read_values, replay


@dataclass(frozen=True, eq=False)
class Worst:
    """The worst case found of one limit.

    Attributes:
        limit: its name.
        usage: 1 on the facet, above 1 outside; infinite where the lap is NaN.
        margin: offset - normal x in the unit of the facet; negative outside.
        step: of errors and tubes the number of periods after which it is met, of inputs and wheels
            the period itself.
        facet: row of the limit; of a tube, of stage step - when, counted from 1.
        when: step of the plan that is followed; 0 for the other limits.
        attack: by name, time first: `start` (1, 3), and the entries of a script.
    """

    limit: str
    usage: float
    margin: float
    step: int
    facet: int
    when: int
    attack: dict[str, np.ndarray]


def confirm(controller: Controller, plant: SearchablePlant, limit: Limit, worst: Worst) -> Worst:
    """Return a worst case with the usage and margin of its replay."""
    played = replay(controller, plant, worst.attack, worst.limit, worst.when)
    values = read_values(worst.limit, played)[worst.step - worst.when]
    stage = worst.step - worst.when - 1 if worst.limit == "tube" else worst.step
    stage = min(stage, len(limit.offsets) - 1)
    normal = np.asarray(limit.normals[stage, worst.facet])
    offset = float(limit.offsets[stage, worst.facet])
    margin = float(offset - normal @ values)
    usage = 1 - margin / (offset - float(normal @ np.asarray(limit.centre)))
    if np.isnan(margin):
        return dataclasses.replace(worst, usage=np.inf, margin=-np.inf)
    return dataclasses.replace(worst, usage=usage, margin=margin)
