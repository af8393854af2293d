"""The witness of slips that are learnt: drives in the world frame, told to the observer that the
controller runs, can refute that its intervals hold the true slips and are as narrow as is proved.

Robots begin at extremes of the certified errors, ask for extremes of the certified inputs, period
after period, and slip as fast as they may from one extreme to the other; those whose errors leave
the caps say nothing from then on. Poses are complex numbers, as in `certificate.period`, which
shares nothing with the observer and its bounds.

Source: new.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxtube.plant.slip_observer import SlipObserver
from jaxtube.precision import in_64_bits
from jaxtube.synthesis.certificate.period import (
    command_wheels,
    next_errors,
    pair_errors_and_inputs,
)
from jaxtube.synthesis.certificate.period_cases import PeriodCases
from jaxtube.synthesis.disturbance import find_learnt_slips
from jaxtube.synthesis.learnt_slips import make_slip_observer
from jaxtube.synthesis.problem import Problem
from sets.certificate import ROUNDING, Condition, judge

ROBOTS = 4096
"""Drives that are tried."""
BEYOND = 2
"""Periods of a drive after the observer looks back as far as it will."""


_update = jax.jit(SlipObserver.update)


class Learnt(NamedTuple):
    """What drives met, by the periods since the start: the widest half of an interval (right,
    left), 0 where no robot was within the caps, and whether every interval held its slip."""

    radius: Float[np.ndarray, "ages 2"]
    holds: bool


def check_learnt_slips(problem: Problem) -> Condition:
    """Check that the intervals of learnt slips hold them and are as narrow as W counts on."""
    try:
        proved = find_learnt_slips(problem).radius
    except ValueError:
        proved = np.zeros((1, 2))
    met = find_learnt(problem)
    ages = np.minimum(np.arange(len(met.radius)), len(proved) - 1)
    room = float(np.min(proved[ages] - met.radius)) if met.holds else -np.inf
    right, left = proved[-1]
    shares = met.radius[-1] / proved[-1]
    return judge(
        "learnt_slips_hold",
        room + ROUNDING,
        "The intervals in which slips are learnt hold the true ones, and the slip that is "
        f"compensated is off by at most {right:.3g} right and {left:.3g} left after "
        f"{len(proved) - 1} periods, by closed formulas; drives tried reach {shares.max():.0%} of "
        "that.",
        "A drive within the certified errors and inputs refutes what is said of learnt slips.",
        "robot",
    )


@in_64_bits
def find_learnt(problem: Problem) -> Learnt:
    """Return what drives met."""
    random = np.random.default_rng(0)
    observer = make_slip_observer(problem)
    least = np.asarray(observer.least)
    greatest = np.asarray(observer.greatest)
    errors, inputs = pair_errors_and_inputs(problem)
    starts = random.integers(len(errors), size=ROBOTS)
    true = errors[starts] * random.uniform(0, 1, (ROBOTS, 1))
    slips = np.where(random.random((ROBOTS, 2)) < 0.5, least, greatest)
    to_upper = random.random((ROBOTS, 2)) < 0.5
    stays = np.ones(ROBOTS, bool)
    known = observer.initial(jnp.asarray(true))
    wheels = np.zeros((ROBOTS, 2))
    reference = np.zeros(2)
    radius = []
    holds = True
    for _ in range(observer.periods + BEYOND):
        noise = problem.noise * random.choice([-1.0, 1.0], (ROBOTS, 3))
        measured = true + noise
        stays = stays & _is_within(problem, measured)
        known = _update(observer, known, *map(jnp.asarray, (measured, wheels, reference)))
        held = (np.asarray(known.lower) <= slips) & (slips <= np.asarray(known.upper))
        holds = holds and bool(np.all(held[stays]))
        widths = np.where(stays[:, None], np.asarray(known.radius), 0.0)
        radius.append(widths.max(axis=0))
        corners = problem.corners
        reference = corners[random.integers(len(corners))]
        asked = inputs[random.integers(len(inputs), size=ROBOTS)]
        cases = PeriodCases(
            errors=measured,
            inputs=_meet_rows(problem, measured, asked),
            wheels=np.broadcast_to(reference, (ROBOTS, 2)),
            slip=slips,
            measured_slip=np.asarray(known.centre),
            sideslip=np.zeros(ROBOTS),
            noise=noise,
        )
        wheels = command_wheels(problem, cases)
        true = next_errors(problem, cases)
        to_upper = np.where(random.random((ROBOTS, 2)) < 0.1, ~to_upper, to_upper)
        change = np.where(to_upper, observer.change, -observer.change)
        slips = np.clip(slips + change, least, greatest)
    return Learnt(np.array(radius), holds)


def _is_within(problem: Problem, errors: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    """Return which measured errors lie within the caps."""
    return np.all(np.abs(errors) <= problem.operating_set.offsets[:3], axis=1)


def _meet_rows(
    problem: Problem, errors: Float[np.ndarray, "n 3"], inputs: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 2"]:
    """Return inputs, shrunk until all rows on inputs and errors are met."""
    rows = problem.cap_rows
    used = inputs @ rows.inputs.T
    left = rows.offsets - errors @ rows.errors.T
    shares = np.where(used > 0, left / np.maximum(used, np.finfo(float).tiny), np.inf)
    return inputs * np.clip(shares.min(axis=1, initial=1.0), 0.0, 1.0)[:, None]
