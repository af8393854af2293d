"""Intervals that always hold the true slips of the wheels, learnt from measured poses on line.

Over a period T with wheel speeds v_w and slips i_w held, the wheels travel T v_w (1 - i_w) over
ground: s + (b/2) phi on the right and s - (b/2) phi on the left, s the length of the body's arc and
phi its turn. Both follow exactly from the tracking errors before and after, z = (x, y, th) and z',
whatever way the reference goes, A = T Om and l = T V sinc(A/2):

    phi = th - th' + A,     h = phi / 2,     m = (th + th') / 2
    s sinc(h) = cos(h) (x - x') + sin(h) (y + y') + l cos(m)

Lateral velocities that are constant over the period leave s as it is: they move the robot across
the chord. Errors are measured within n of the true ones, so the travel over the last N periods is
known within

    sum over the N + 1 instants of |gradient of the travel| n  +  a bound on its second derivatives,

and what the noise of an instant does in one period it takes back in the next: most of it is that of
the first and the last. With rolled_j = T v_w(j) the mean slip, weighted by rolled_j, is known as
well, and where no slip changes by more than c a period, that of the period which begins differs
from it by at most c sum_j |rolled_j| (periods since j began) / |sum_j rolled_j|. The interval is
where the windows of N = 1, 2, .. periods, the interval before, grown by c, and [least, greatest]
agree. Nowhere is a statement of chance: while noise and slips keep their bounds the true slip lies
inside. Where nothing is left they were not kept: the interval is [least, greatest] again, and
`contradicted` says so.

Source: new; estimation by sets that are bounded and intersected goes back to Schweppe 1968, IEEE
Trans. Automatic Control 13(1).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int

from jaxtube.plant.angles import sinc, sine_and_cosine

MOST_HALF_TURN = 0.5
"""Half turn of a period, rad, beyond which nothing is learnt from it: the bounds on derivatives
below hold within."""
ROUNDING = 1e-9
"""What an interval is wider by on either side, for the rounding of some hundred operations."""


class Travel(NamedTuple):
    """What the measurements before and after each of the last periods say of it, the last one
    first; zeros where they say nothing.

    Attributes:
        arc: s, m.
        turn: phi, rad.
        along: derivative of s by x, and minus that by x'.
        before, after: derivatives of s by th and th', m/rad.
        beyond: what these leave of the effect of the noise, m.
        right, left: what these wheels rolled, T v_w, m.
    """

    arc: Float[Array, "batch periods"]
    turn: Float[Array, "batch periods"]
    along: Float[Array, "batch periods"]
    before: Float[Array, "batch periods"]
    after: Float[Array, "batch periods"]
    beyond: Float[Array, "batch periods"]
    right: Float[Array, "batch periods"]
    left: Float[Array, "batch periods"]


class SlipKnowledge(NamedTuple):
    """What is known of the slips (right, left) of the period that begins.

    Attributes:
        lower, upper: ends of the intervals that hold them.
        contradicted: whether the last measurements said that noise or slips did not keep their
            bounds, so that nothing is known.
        errors: last measured, (m, m, rad).
        past: the periods before.
        count: how many of them are connected, -1 before the first measurement.
    """

    lower: Float[Array, "batch 2"]
    upper: Float[Array, "batch 2"]
    contradicted: Bool[Array, " batch"]
    errors: Float[Array, "batch 3"]
    past: Travel
    count: Int[Array, " batch"]

    @property
    def centre(self) -> Float[Array, "batch 2"]:
        """The slips to compensate: never further from the true ones than `radius`."""
        return (self.lower + self.upper) / 2

    @property
    def radius(self) -> Float[Array, "batch 2"]:
        """Half widths of the intervals."""
        return (self.upper - self.lower) / 2


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["least", "greatest", "change", "noise", "track_width", "dt"],
    meta_fields=["periods"],
)
@dataclass(frozen=True)
class SlipObserver:
    """An observer of the slips (see the module).

    Attributes:
        least, greatest: ends of the intervals (right, left) that the true slips never leave.
        change: c, greatest change of a slip from one period to the next.
        noise: half widths of the error of measured errors in the robot's frame, (m, m, rad).
        track_width: m.
        dt: period, s.
        periods: that are looked back at.
    """

    least: Float[Array, "2"]
    greatest: Float[Array, "2"]
    change: float
    noise: Float[Array, "3"]
    track_width: float
    dt: float
    periods: int

    def initial(self, errors: Float[Array, "batch 3"]) -> SlipKnowledge:
        """Return what is known before the first measurement; `errors` gives the batch."""
        batch = len(errors)
        none = jnp.zeros((batch, self.periods), errors.dtype)
        return SlipKnowledge(
            lower=jnp.broadcast_to(self.least, (batch, 2)).astype(errors.dtype),
            upper=jnp.broadcast_to(self.greatest, (batch, 2)).astype(errors.dtype),
            contradicted=jnp.zeros(batch, bool),
            errors=jnp.zeros_like(errors),
            past=Travel(*[none] * len(Travel._fields)),
            count=jnp.full(batch, -1, jnp.int32),
        )

    def update(
        self,
        known: SlipKnowledge,
        errors: Float[Array, "batch 3"],
        wheels: Float[Array, "batch 2"],
        reference_wheels: Float[Array, "2"] | Float[Array, "batch 2"],
    ) -> SlipKnowledge:
        """Return what is known once a period has ended.

        Args:
            known: before; the first measurement only begins.
            errors: measured at the end of the period, (m, m, rad).
            wheels: speeds (right, left) that the wheels had over it, m/s.
            reference_wheels: those of the reference, m/s.

        Returns:
            The intervals of the slips of the next period. Measurements that are not finite say
            nothing; nothing raises.
        """
        travel, is_usable = self._measure(known.errors, errors, wheels, reference_wheels)
        count = jnp.where(is_usable & (known.count >= 0), known.count + 1, 0)
        past = jax.tree.map(_push, travel, known.past)
        sides = [self._intersect(known, past, count, wheel) for wheel in (0, 1)]
        lower = jnp.stack([side[0] for side in sides], axis=-1)
        upper = jnp.stack([side[1] for side in sides], axis=-1)
        contradicted = ~jnp.all(lower <= upper, axis=-1)
        start = self.initial(errors)
        return SlipKnowledge(
            lower=jnp.where(contradicted[:, None], start.lower, lower),
            upper=jnp.where(contradicted[:, None], start.upper, upper),
            contradicted=contradicted,
            errors=errors,
            past=past,
            count=jnp.where(contradicted, 0, jnp.minimum(count, self.periods)),
        )

    def _measure(
        self,
        errors: Float[Array, "batch 3"],
        following: Float[Array, "batch 3"],
        wheels: Float[Array, "batch 2"],
        reference_wheels: Float[Array, "2"] | Float[Array, "batch 2"],
    ) -> tuple[Travel, Bool[Array, " batch"]]:
        """Return what the errors before and after a period say of it, numbers (batch), and whether
        they do."""
        x, y, heading = jnp.unstack(errors, axis=-1)
        next_x, next_y, next_heading = jnp.unstack(following, axis=-1)
        right, left = jnp.unstack(reference_wheels, axis=-1)
        reference_turn = self.dt * (right - left) / self.track_width
        reference_chord = self.dt * (right + left) / 2.0
        reference_chord = reference_chord * sinc(reference_turn / 2.0)
        turn = heading - next_heading + reference_turn
        half_turn = turn / 2.0
        sine, cosine = sine_and_cosine(half_turn)
        mean_sine, mean_cosine = sine_and_cosine((heading + next_heading) / 2.0)
        shortening = sinc(half_turn, (sine, cosine))
        change = x - next_x
        sway = y + next_y
        chord = cosine * change + sine * sway + reference_chord * mean_cosine
        # Derivatives by h, but for the small terms that `_bound_rest` bounds, and by m.
        of_half_turn = sway
        of_mean = -reference_chord * mean_sine / shortening
        travel = Travel(
            arc=chord / shortening,
            turn=turn,
            along=cosine / shortening,
            before=(of_half_turn + of_mean) / 2.0,
            after=(of_mean - of_half_turn) / 2.0,
            beyond=self._bound_rest(half_turn, change, reference_chord),
            right=self.dt * wheels[:, 0],
            left=self.dt * wheels[:, 1],
        )
        is_finite = jnp.isfinite(travel.arc + travel.right + travel.left)
        is_usable = is_finite & (jnp.abs(half_turn) + self.noise[2] <= MOST_HALF_TURN)
        return jax.tree.map(lambda each: jnp.where(is_usable, each, 0.0), travel), is_usable

    def _bound_rest(
        self, half_turn: Float[Array, " batch"], change: Float[Array, " batch"], chord
    ) -> Float[Array, " batch"]:
        """Return what the derivatives of a period leave of the effect of the noise on its arc, m.

        With k(h) = h cot h and r(h) = h / sin h,  s = k (x - x') + h (y + y') + l r cos m,  and for
        |h| <= 1/2

            |k'| <= 0.7 |h| <= 0.35     |k''| <= 0.75     r <= 1.05     0 <= r' / h <= 0.36
            |r'| <= 0.18                |r''| <= 0.4

        for all are power series in h^2, times h or not, whose terms have one sign. The noise moves
        x - x' and y + y' by up to 2 n_x and 2 n_y, and h and m by n_th. The derivative by h leaves
        out k' (x - x') + l r' cos m; half the second derivatives, times the noise twice, bound the
        remainder of Taylor's series.
        """
        of_x, of_y, of_heading = jnp.unstack(jnp.asarray(self.noise))
        size = jnp.abs(half_turn)
        length = jnp.abs(chord)
        change = jnp.abs(change)
        left_out = size * (0.7 * change + 0.36 * length) * of_heading
        curved = (0.375 * (change + 2.0 * of_x) + 0.905 * length) * of_heading**2
        return left_out + curved + (0.7 * of_x + 2.0 * of_y) * of_heading

    def _intersect(
        self, known: SlipKnowledge, past: Travel, count: Int[Array, " batch"], wheel: int
    ) -> tuple[Float[Array, " batch"], Float[Array, " batch"]]:
        """Return the ends of the interval of one wheel, crossed where nothing is left."""
        lower = jnp.maximum(known.lower[:, wheel] - self.change, self.least[wheel])
        upper = jnp.minimum(known.upper[:, wheel] + self.change, self.greatest[wheel])
        mean, reach = self._find_windows(past, wheel)
        is_known = jnp.arange(self.periods, dtype=jnp.int32) < count[:, None]
        reach = jnp.where(is_known, reach + ROUNDING, jnp.inf)
        mean = jnp.where(is_known, mean, 0.0)
        return (
            jnp.maximum(lower, jnp.max(mean - reach, axis=1)),
            jnp.minimum(upper, jnp.min(mean + reach, axis=1)),
        )

    def _find_windows(
        self, past: Travel, wheel: int
    ) -> tuple[Float[Array, "batch periods"], Float[Array, "batch periods"]]:
        """Return, for windows of 1, 2, .. periods, the mean slip measured and how far the slip of
        the period that begins may lie from it."""
        half_track = self.track_width / 2.0 * (1.0 if wheel == 0 else -1.0)
        rolled = past.left if wheel else past.right
        travel = past.arc + half_track * past.turn
        at_begin = self._weigh(past.along, past.turn, past.before + half_track)
        at_end = self._weigh(past.along, past.turn, past.after - half_track)[:, :1]
        inside = self._weigh(
            past.along[:, :-1] - past.along[:, 1:],
            past.turn[:, :-1] + past.turn[:, 1:],
            past.before[:, :-1] + past.after[:, 1:],
        )
        inside = jnp.pad(inside, ((0, 0), (1, 0)))
        ages = jnp.arange(1, self.periods + 1).astype(rolled.dtype)
        drift = self.change * _add_up(jnp.abs(rolled) * ages)
        reach = at_end + _add_up(inside + past.beyond) + at_begin + drift
        total = _add_up(rolled)
        is_rolling = jnp.abs(total) > 0.0
        divisor = jnp.where(is_rolling, total, 1.0)
        mean = 1.0 - _add_up(travel) / divisor
        return mean, jnp.where(is_rolling, reach / jnp.abs(divisor), jnp.inf)

    def _weigh(
        self,
        along: Float[Array, "batch n"],
        turn: Float[Array, "batch n"],
        heading: Float[Array, "batch n"],
    ) -> Float[Array, "batch n"]:
        """Return what noise makes of derivatives by x, by y, which are half the turn, and by th."""
        of_x, of_y, of_heading = jnp.unstack(jnp.asarray(self.noise))
        return of_x * jnp.abs(along) + of_y * jnp.abs(turn) / 2.0 + of_heading * jnp.abs(heading)


def _push(
    last: Float[Array, " batch"], before: Float[Array, "batch periods"]
) -> Float[Array, "batch periods"]:
    """Return numbers of the last periods with those of one more, the oldest left out."""
    return jnp.concatenate([last[:, None], before[:, :-1]], axis=1)


def _add_up(numbers: Float[Array, "batch periods"]) -> Float[Array, "batch periods"]:
    """Return the sums over windows of 1, 2, .. periods."""
    total = numbers[:, 0]
    sums = [total]
    for back in range(1, numbers.shape[1]):
        total = total + numbers[:, back]
        sums.append(total)
    return jnp.stack(sums, axis=1)
