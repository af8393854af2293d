"""References along a curve: its lengths at the periods' ends become wheel speeds held over each.

Each period drives as far as the curve is long and turns as much as the curve does, so that its
wheel speeds are means of those along the curve: what bounds speeds and accelerations there bounds
them here. Single arcs leave a curve whose curvature changes by some h^2 / 12 of the change, h being
the step; so little is taken back by a slow feedback of the errors e_y and e_th of the pose that is
reached,

    turn = curve's turn - a e_th - (c / h) e_y        length = curve's length - d e_x

with poles in e_y and e_th at `POLE` twice.

Source: pole placement as in any textbook, for e_y+ = e_y + h (e_th + turn / 2), e_th+ = e_th + turn
relative to the curve.
"""

import numpy as np
from jaxtyping import Float

from jaxtube.paths.curve import Curve
from jaxtube.plant.reference import Reference, make_reference

POLE = 0.8
"""Of the errors from period to period: small corrections, which wheels hardly feel."""

# From det = 1 - a + c / 2 = POLE^2 and trace = 2 - a - c / 2 = 2 POLE.
HEADING_GAIN = (3.0 - 2.0 * POLE - POLE**2) / 2.0
LATERAL_GAIN = (1.0 - POLE) ** 2


def follow(
    curve: Curve,
    lengths: Float[np.ndarray, "periods+1"],
    held: int,
    dt: float,
    steps: int,
    track_width: float,
) -> Reference:
    """Return the reference that is at given arc lengths of a curve at the ends of its periods.

    Args:
        curve: to be followed.
        lengths: arc lengths at the periods' ends, m, increasing.
        held: further periods, in which the last wheel speeds are held.
        dt: length of a period, s.
        steps: periods of the run; the others are its preview.
        track_width: m.
    """
    samples = curve.at(lengths)
    points = samples.positions @ np.array([1.0, 1.0j])  # the plane as complex numbers
    steps_along = np.diff(lengths)
    turns = np.diff(samples.headings)
    position = points[0]
    heading = samples.headings[0]
    for period, step in enumerate(steps_along):
        off = (position - points[period]) * np.exp(-1j * samples.headings[period])
        turn = turns[period] - HEADING_GAIN * (heading - samples.headings[period])
        turn -= LATERAL_GAIN * off.imag / step
        arc = step - (1.0 - POLE) * off.real
        position += arc * np.sinc(turn / (2.0 * np.pi)) * np.exp(1j * (heading + turn / 2.0))
        heading += turn
        turns[period] = turn
        steps_along[period] = arc
    return make_reference(
        start=np.append(samples.positions[0], samples.headings[0]),
        speeds=np.pad(steps_along / dt, (0, held), "edge"),
        yaw_rates=np.pad(turns / dt, (0, held), "edge"),
        dt=dt,
        steps=steps,
        track_width=track_width,
    )
