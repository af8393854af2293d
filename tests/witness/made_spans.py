"""Spans whose truth is known: a robot that slips as it is told, integrated in the world frame."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

from jaxtube.plant.error_dynamics import tracking_error, world_pose
from jaxtube.witness.motion import NOISES, Allowance
from jaxtube.witness.spans import KINDS, Spans

ALLOWED = Allowance(
    track=0.8,
    lever_arm=0.07,
    nominal=np.array([0.1, 0.05]),
    slip=(np.array([0.12, 0.02]), np.array([0.08, 0.06])),
    sideslip=0.05,
    noise=np.array([0.004, 0.003, 0.005]),
    frame="robot",
)


def make_spans(frame, pieces, count=12, seed=0, spread=1.0, steps=2):
    """Return what is allowed, spans, and the deviations (count, v) that made them.

    Args:
        frame: of the noise.
        pieces: of a span.
        count: of spans.
        seed: of all that is drawn.
        spread: greatest deviation.
        steps: of a piece, over which wheels are constant.
    """
    draw = np.random.default_rng(seed)
    allowed = replace(ALLOWED, frame=frame)
    duration = draw.uniform(0.1, 0.14, count) * pieces
    ways = draw.uniform(-0.2, 1.2, (count, pieces * steps, 2))
    ways *= duration[:, None, None] / (pieces * steps)
    first = draw.uniform(-3.0, 3.0, (count, 3))
    deviations = draw.uniform(-spread, spread, (count, allowed.count(pieces)))
    middle, half = allowed.box(pieces)
    values = middle + half * deviations
    last = [_measure_end(allowed, *each) for each in zip(first, ways, values, strict=True)]
    steady = np.full(count, KINDS.index("steady"))
    spans = Spans(
        length=float(duration.mean()),
        start=np.zeros(count),
        end=duration,
        first=first,
        last=np.array(last),
        ways=ways,
        pieces=pieces,
        kind=steady,
        command=np.arange(count),
    )
    return allowed, spans, deviations


def _measure_end(allowed, measured, ways, values):
    """Return the pose that is measured at the end of a span."""
    slips = values[:-NOISES].reshape(-1, 3)
    before = values[-NOISES:-3]
    after = values[-3:]
    nominal = np.tile([*allowed.nominal, 0.0], (len(slips), 1))
    reference = _drive(allowed, measured, ways, nominal, lever_arm=0.0)
    if allowed.frame == "world":
        true = _drive(allowed, measured - before, ways, slips, allowed.lever_arm)
        return true + after
    start = np.asarray(world_pose(jnp.asarray(-before), jnp.asarray(measured)))
    true = _drive(allowed, start, ways, slips, allowed.lever_arm)
    error = np.asarray(tracking_error(jnp.asarray(true), jnp.asarray(reference)))
    return np.asarray(world_pose(jnp.asarray(error + after), jnp.asarray(reference)))


def _drive(allowed, pose, ways, slips, lever_arm):
    """Return where a robot ends, by an integrator; a step takes one unit of time."""
    for step, way in enumerate(ways):
        right_slip, left_slip, sideslip = slips[step * len(slips) // len(ways)]
        right, left = way * (1.0 - np.array([right_slip, left_slip]))
        yaw_rate = (right - left) / allowed.track
        forwards = (right + left) / 2
        velocity = forwards + 1j * (sideslip * forwards - lever_arm * yaw_rate)

        def rates(_, pose, velocity=velocity, yaw_rate=yaw_rate):
            moving = velocity * np.exp(1j * pose[2])
            return [moving.real, moving.imag, yaw_rate]

        pose = solve_ivp(rates, (0.0, 1.0), pose, rtol=1e-12, atol=1e-14).y[:, -1]
    return pose
