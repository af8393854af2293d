"""Poses in the world as pairs (complex place, heading), how motions join them, and their tracking
errors.

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, eq. (3), for the error.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from jaxtube.synthesis.certificate.period_cases import Numbers


class Poses(NamedTuple):
    """Poses in the world, or motions from one to another."""

    place: Complex[np.ndarray, " n"]
    heading: Numbers

    def join(self, motion: Poses) -> Poses:
        """Return where motions lead from here."""
        place = self.place + motion.place * np.exp(1j * self.heading)
        return Poses(place, self.heading + motion.heading)

    def back(self) -> Poses:
        """Return the motions back."""
        return Poses(-self.place * np.exp(-1j * self.heading), -self.heading)


def run_out(speed: Numbers, turn: Numbers, lag: float) -> Poses:
    """Return the motion of wheels that run out: a way ahead, and then a turn."""
    return Poses(lag * speed + 0j, lag * turn)


def arc(speed: Numbers, turn: Numbers, time: float) -> Poses:
    """Return the motion along an arc."""
    half = time * turn / 2
    return Poses(time * speed * np.sinc(half / np.pi) * np.exp(1j * half), time * turn)


def pose_of(errors: Float[np.ndarray, "n 3"], reference: Poses) -> Poses:
    """Return the poses that have errors against a reference."""
    heading = reference.heading - errors[:, 2]
    place = reference.place - (errors[:, 0] + 1j * errors[:, 1]) * np.exp(1j * heading)
    return Poses(place, heading)


def error_of(pose: Poses, reference: Poses) -> Float[np.ndarray, "n 3"]:
    """Return the tracking errors of poses against a reference."""
    offset = np.exp(-1j * pose.heading) * (reference.place - pose.place)
    return np.stack([np.real(offset), np.imag(offset), reference.heading - pose.heading], axis=1)


def find_body(
    wheels: Float[np.ndarray, "... 2"], track_width: float
) -> tuple[Float[np.ndarray, "..."], Float[np.ndarray, "..."]]:
    """Return the body's (speed m/s, yaw rate rad/s) from the speeds of the wheels (right, left), or
    its way and turn from theirs."""
    right, left = np.moveaxis(wheels, -1, 0)
    return (right + left) / 2, (right - left) / track_width
