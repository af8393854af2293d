"""Where the slips of a robot may lie: what it does, and what its controller believes.

    true      i   = middle + half_width xi_true
    measured  i_m = base + (absolute_error + relative_error |i|) xi_measured
              base: i where the slip is measured, else the constant nominal one

with xi in [-1, 1]^2, (right, left).

A wheel commanded under i_m for the ground speed g makes g (1 - d) of it, d = (i - i_m) / (1 - i_m),
which grows with i and falls with i_m. With i_m tied to i, |d| is monotone on either side of i = 0,
and largest at an end of the interval, so that the extremes of xi give those of d.

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, section IV, for slips near a nominal one; intervals
are new.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import partial

import jax
import numpy as np
from jax import Array
from jaxtyping import Float

from jaxtube.scenario.tree import Slip

Numbers = Float[Array | np.ndarray, "... 2"]


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["middle", "half_width", "nominal", "absolute_error", "relative_error"],
    meta_fields=["is_measured", "uncertain_slip"],
)
@dataclass(frozen=True)
class SlipBounds:
    """Bounds of true and measured slips (module docstring), made by `slip_bounds` or
    `near_nominal`.

    Attributes:
        middle: of the true slips (right, left).
        half_width: of their intervals.
        nominal: what is compensated where slips are not measured.
        absolute_error: greatest error of the measured slip, beside the relative one.
        relative_error: of the measured slip, as a share of the true one.
        is_measured: whether the measured slip follows the true one.
        uncertain_slip: which of the slips deviate, "true", "measured" or "both".
    """

    middle: Float[Array | np.ndarray, "2"]
    half_width: Float[Array | np.ndarray, "2"]
    nominal: Float[Array | np.ndarray, "2"]
    absolute_error: Float[Array | np.ndarray, "2"]
    relative_error: float
    is_measured: bool = False
    uncertain_slip: str = "true"

    def true_slip(self, deviation: Numbers) -> Numbers:
        """Return the true slips of deviations in [-1, 1]."""
        return self.middle + self.half_width * deviation

    def measured_slip(self, true_deviation: Numbers, measured_deviation: Numbers) -> Numbers:
        """Return what is measured under deviations of the true and the measured slips in
        [-1, 1]."""
        if not self.is_measured:
            return self.nominal + self.absolute_error * measured_deviation
        true = self.true_slip(true_deviation)
        greatest_error = self.absolute_error + self.relative_error * abs(true)
        return true + greatest_error * measured_deviation

    def without_errors(self) -> SlipBounds:
        """Return the bounds of slips that are the nominal ones and known."""
        none = self.half_width * 0.0
        return SlipBounds(self.nominal, none, self.nominal, none, 0.0)

    def extremes(self) -> Float[np.ndarray, "k 2 2"]:
        """Return (true, measured) slips (right, left) at all extremes of the deviations."""
        corners = np.array(list(itertools.product((-1.0, 1.0), repeat=2)))
        pairs = np.array(list(itertools.product(corners, corners)))
        true = np.asarray(self.true_slip(pairs[:, 0]))
        measured = np.asarray(self.measured_slip(pairs[:, 0], pairs[:, 1]))
        return np.unique(np.stack([true, measured], axis=1), axis=0)


def slip_bounds(slip: Slip) -> SlipBounds:
    """Return the bounds of the slips that a scenario describes."""
    nominal = np.array(slip.nominal)
    if slip.right is None or slip.left is None:
        return near_nominal(nominal, slip.relative_error, slip.random)
    ends = np.array([slip.right, slip.left])
    return SlipBounds(
        middle=ends.mean(axis=1),
        half_width=(ends[:, 1] - ends[:, 0]) / 2,
        nominal=nominal,
        absolute_error=np.full(2, slip.measurement_error or 0.0),
        relative_error=slip.measurement_error_relative or 0.0,
        is_measured=slip.is_measured,
        uncertain_slip="both" if slip.is_measured else "true",
    )


def slip_steps(slip: Slip, dt: float) -> tuple[float, float] | None:
    """Return the greatest changes of the deviations of the true slips (right, left) over a period
    dt, s; None where they may jump."""
    if slip.change_per_s is None:
        return None
    half_width = slip_bounds(slip).half_width
    steps = slip.change_per_s * dt / np.maximum(half_width, np.finfo(float).tiny)
    right, left = np.minimum(steps, 2.0).tolist()
    return right, left


def near_nominal(
    nominal: Float[np.ndarray, "2"], relative_error: float, uncertain_slip: str
) -> SlipBounds:
    """Return the bounds of slips within a share of constant nominal ones.

    Args:
        nominal: (right, left).
        relative_error: greatest deviation, as a share of the nominal slip.
        uncertain_slip: which slip deviates, "true", "measured" or "both", the other one nominal.
    """
    deviation = np.abs(nominal) * relative_error
    none = np.zeros(2)
    return SlipBounds(
        middle=nominal,
        half_width=none if uncertain_slip == "measured" else deviation,
        nominal=nominal,
        absolute_error=none if uncertain_slip == "true" else deviation,
        relative_error=0.0,
        uncertain_slip=uncertain_slip,
    )


def compensated_slips(slip: Slip) -> Float[np.ndarray, "2 2"]:
    """Return the (least, greatest) slips (right, left) that the controller may believe in; around a
    nominal slip those of either reading."""
    bounds = slip_bounds(slip)
    if not slip.has_intervals:
        deviation = np.abs(bounds.nominal) * slip.relative_error
        return np.stack([bounds.nominal - deviation, bounds.nominal + deviation])
    if slip.is_learnt:
        return np.stack([bounds.middle - bounds.half_width, bounds.middle + bounds.half_width])
    measured = bounds.extremes()[:, 1]
    return np.stack([measured.min(axis=0), measured.max(axis=0)])
