"""The linear parameter-varying prediction model of the tracking error.

    e+ = A(th) e + B(th) u + w,   th = (V_r, V_l) in Theta
    e_x' = Om e_y + u1            e_y' = -Om e_x + V e_th            e_th' = u2

th, the schedule, is the pair of reference wheel speeds in m/s, Theta the box it lies in. Two
choices make four models, and a fifth is sampled from the start:

* `paper` takes Om = ((1 - i_r) V_r - (1 - i_l) V_l) / b, the Jacobian at wheels that do not
  compensate their slip; `consistent` takes Om = (V_r - V_l) / b, the Jacobian of the dynamics under
  commands that do. They differ by T i Om.
* `euler` is I + T (.), affine in the schedule; `zoh` is exact over a period with the inputs held,
  and not affine.
* `exact_jacobian` is the Jacobian at 0 of the sampled robot under the input map `x_exact`, with A_
  = T Om, h = tan(A_ / 2) and c = T V h / (A_ / 2):

      A = [[1, T Om, 0], [-2 h, 1 - h T Om, c], [0, 0, 1]]
      B = [[T, 0], [-h T, c T / 2], [0, T]].

Errors are (longitudinal m, lateral m, heading rad), inputs (speed deficit m/s, yaw rate deficit
rad/s).

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (6), (9)-(10), (16)-(25), (34)-(37).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import expm

MODELS = ("paper", "consistent", "exact_jacobian")
DISCRETISATIONS = ("euler", "zoh")

VERTEX_SIDES = np.array([[0, 1], [0, 0], [1, 0], [1, 1]])
"""Sides of (V_r, V_l), lower 0 or upper 1, at the four vertices in the order of eqs. (34)-(37)."""

RIGHT_MINUS_LEFT = np.array([1.0, -1.0])
"""Takes wheel speeds (right, left) to b times the yaw rate."""


@dataclass(frozen=True, eq=False)
class Model:
    """The prediction model, made by `make_model`.

    Attributes:
        dt: period, s.
        track_width: b, m.
        slip_factors: (right, left), what part of a wheel's speed counts in the yaw rate: 1 -
            nominal slip, or 1.
        discretisation: "euler", "zoh" or, for the exact Jacobian, "exact".
        box: Theta as (lower, upper), each (right, left) in m/s.
    """

    dt: float
    track_width: float
    slip_factors: Float[np.ndarray, "2"]
    discretisation: str
    box: tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]

    def matrices(
        self, schedule: Float[np.ndarray, "... 2"]
    ) -> tuple[Float[np.ndarray, "... 3 3"], Float[np.ndarray, "... 3 2"]]:
        """Return A and B at one or many schedules.

        Args:
            schedule: reference wheel speeds (right, left), m/s.

        Returns:
            (A, B), with eigenvalues of modulus 1 and above; B depends on the schedule except under
            `euler`.
        """
        schedule = np.asarray(schedule, float)
        if self.discretisation == "exact":
            return self._exact_pair(schedule)
        rates = self._continuous_pair(schedule) * self.dt
        transition = expm(rates) if self.discretisation == "zoh" else np.eye(5) + rates
        return transition[..., :3, :3], transition[..., :3, 3:]

    def _continuous_pair(
        self, schedule: Float[np.ndarray, "... 2"]
    ) -> Float[np.ndarray, "... 5 5"]:
        """Return the matrix of the rates of (error, held input), eq. (6)."""
        yaw_rate = schedule * self.slip_factors @ RIGHT_MINUS_LEFT / self.track_width
        rates = np.zeros((*schedule.shape[:-1], 5, 5))
        rates[..., 0, 1] = yaw_rate
        rates[..., 1, 0] = -yaw_rate
        rates[..., 1, 2] = schedule.mean(axis=-1)
        rates[..., 0, 3] = 1.0
        rates[..., 2, 4] = 1.0
        return rates

    def stretched(self, schedule: Float[np.ndarray, "... 2"]) -> Float[np.ndarray, "... 2"]:
        """Return the wheel speeds times tan(x) / x, x = T Om / 2: the exact Jacobian's h and c are
        linear in them.

        Args:
            schedule: reference wheel speeds (right, left), m/s, that turn by less than half a turn
                a period.
        """
        turn = self._turn(schedule)
        stretch = np.sinc(turn / (2.0 * np.pi)) / np.cos(turn / 2.0)
        return schedule * stretch[..., None]

    def turn_and_reach(self, stretched: Float[np.ndarray, "... 2"]) -> Float[np.ndarray, "... 2"]:
        """Return (h, c) of the exact Jacobian from stretched wheel speeds: c +- b h is T times the
        right or left one."""
        right, left = np.moveaxis(self.dt * stretched, -1, 0)
        h = (right - left) / (2.0 * self.track_width)
        c = (right + left) / 2.0
        return np.stack([h, c], axis=-1)

    def stretched_box(
        self, lower: Float[np.ndarray, "2"], upper: Float[np.ndarray, "2"]
    ) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
        """Return a box around the stretched speeds of a box of positive wheel speeds; exact where
        the box is a point.

        Raises:
            ValueError: where a speed is not positive.
        """
        if np.array_equal(lower, upper):
            return self.stretched(lower), self.stretched(upper)
        _refuse_unless(
            bool(np.min(lower) > 0.0),
            "box",
            [lower.tolist(), upper.tolist()],
            "the exact Jacobian needs positive wheel speeds; raise the lower ones",
        )
        # tan(x) / x is 1 at least and grows with |x|, so it is largest at one of the two turning
        # corners.
        turning = np.array([[lower[0], upper[1]], [upper[0], lower[1]]])
        greatest_stretch = float(np.max(self.stretched(turning) / turning))
        return lower, upper * greatest_stretch

    def _turn(self, schedule: Float[np.ndarray, "... 2"]) -> Float[np.ndarray, "..."]:
        """Return T Om, the turn of the reference in one period, rad."""
        return self.dt * schedule @ RIGHT_MINUS_LEFT / self.track_width

    def _exact_pair(
        self, schedule: Float[np.ndarray, "... 2"]
    ) -> tuple[Float[np.ndarray, "... 3 3"], Float[np.ndarray, "... 3 2"]]:
        """Return A and B of the exact Jacobian."""
        stretched = self.stretched(schedule)
        h, c = np.moveaxis(self.turn_and_reach(stretched), -1, 0)
        T = self.dt
        turn = self._turn(schedule)
        A = np.zeros((*h.shape, 3, 3))
        A[..., 0, 0] = 1.0
        A[..., 0, 1] = turn
        A[..., 1, 0] = -2.0 * h
        A[..., 1, 1] = 1.0 - h * turn
        A[..., 1, 2] = c
        A[..., 2, 2] = 1.0
        B = np.zeros((*h.shape, 3, 2))
        B[..., 0, 0] = T
        B[..., 1, 0] = -h * T
        B[..., 1, 1] = c * T / 2.0
        B[..., 2, 1] = T
        return A, B

    @property
    def centre(self) -> Float[np.ndarray, "2"]:
        """Schedule (right, left) at the centre of the box, m/s: the nominal one of eq. (19)."""
        lower, upper = self.box
        return (lower + upper) / 2.0

    @property
    def half_widths(self) -> Float[np.ndarray, "2"]:
        """Half widths (right, left) of the box, m/s: the greatest deviations of eq. (19)."""
        lower, upper = self.box
        return (upper - lower) / 2.0

    @property
    def vertices(self) -> Float[np.ndarray, "4 2"]:
        """Schedules at the four corners: (min, max), (min, min), (max, min), (max, max), as in eqs.
        (34)-(37)."""
        return np.stack(self.box)[VERTEX_SIDES, [0, 1]]

    def weights(self, schedule: Float[np.ndarray, "... 2"]) -> Float[np.ndarray, "... 4"]:
        """Return the bilinear weights of the vertices.

        Args:
            schedule: reference wheel speeds (right, left), m/s.

        Returns:
            Weights in the order of `vertices`: they sum to 1 and reproduce the schedule, hence
            `euler`'s A, exactly. They are non-negative for a schedule in the box, and extrapolate
            outside it.
        """
        return bilinear_weights(np.asarray(schedule, float), *self.box)

    @property
    def slopes(self) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3 3"]]:
        """Slopes (A_r, A_l) of A in the two wheel speeds, s/m, eq. (17).

        Raises:
            ValueError: for `zoh`, whose A is not affine.
        """
        if self.discretisation != "euler":
            raise ValueError(
                f"model: discretisation = {self.discretisation!r} has no slopes, "
                "its A is not affine; use 'euler'"
            )
        right, left = self._continuous_pair(np.eye(2))[:, :3, :3] * self.dt
        return right, left

    def compensating_gains(self) -> tuple[Float[np.ndarray, "2 3"], Float[np.ndarray, "2 3"]]:
        """Return the gains (K_r, K_l) per m/s of wheel speed that cancel the first rows of A_r and
        A_l, eq. (24).

        Returns:
            Gains for u = +K e: A_r + B K_r and A_l + B K_l of `euler` have zeros except in the row
            of the lateral error.
        """
        right_factor, left_factor = self.slip_factors / self.track_width
        right = np.zeros((2, 3))
        right[0, 1] = -right_factor
        left = np.zeros((2, 3))
        left[0, 1] = left_factor
        return right, left


def bilinear_weights(
    points: Float[np.ndarray, "... 2"], lower: Float[np.ndarray, "2"], upper: Float[np.ndarray, "2"]
) -> Float[np.ndarray, "... 4"]:
    """Return the bilinear weights of the four corners of a box, in the order of `VERTEX_SIDES`;
    some are negative outside the box."""
    width = np.where(upper > lower, upper - lower, 1.0)
    upper_share = (points - lower) / width
    upper_share = upper_share[..., None, :]
    shares = np.where(VERTEX_SIDES == 1, upper_share, 1.0 - upper_share)
    return shares.prod(axis=-1)


def make_model(
    model: str,
    discretisation: str,
    dt: float,
    track_width: float,
    nominal_slip: Float[np.ndarray, "2"],
    box: tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]],
) -> Model:
    """Make a prediction model.

    Args:
        model: "paper", "consistent" or "exact_jacobian".
        discretisation: "euler" or "zoh"; the exact Jacobian is sampled already and does not read
            it.
        dt: period, s.
        track_width: m.
        nominal_slip: (right, left), in (-1, 1).
        box: least and greatest reference wheel speeds, each (right, left) in m/s.

    Returns:
        The model.

    Raises:
        ValueError: for an unknown choice, a setting out of range, or a box with its bounds crossed.
    """
    slip = np.asarray(nominal_slip, float)
    lower = np.asarray(box[0], float)
    upper = np.asarray(box[1], float)
    _refuse_unless_among(MODELS, "model", model)
    _refuse_unless_among(DISCRETISATIONS, "discretisation", discretisation)
    _refuse_unless(0.0 < dt < np.inf, "dt", dt, "give a positive number of seconds")
    has_width = 0.0 < track_width < np.inf
    _refuse_unless(has_width, "track_width", track_width, "give a positive length in m")
    is_slip = slip.shape == (2,) and bool(np.all(np.abs(slip) < 1.0))
    _refuse_unless(is_slip, "nominal_slip", slip.tolist(), "give (right, left) in (-1, 1)")
    ends = [lower.tolist(), upper.tolist()]
    cure = "give finite (right, left) speeds, the lower ones first"
    _refuse_unless(_is_box(lower, upper), "box", ends, cure)
    slip_factors = 1.0 - slip if model == "paper" else np.ones(2)
    sampling = "exact" if model == "exact_jacobian" else discretisation
    return Model(dt, track_width, slip_factors, sampling, (lower, upper))


def _is_box(lower: Float[np.ndarray, "..."], upper: Float[np.ndarray, "..."]) -> bool:
    """Return whether two bounds are finite pairs in order."""
    if lower.shape != (2,) or upper.shape != (2,):
        return False
    is_finite = np.isfinite(lower).all() and np.isfinite(upper).all()
    return bool(is_finite and np.all(lower <= upper))


def _refuse_unless_among(choices: tuple[str, ...], field: str, value: str) -> None:
    """Refuse an unknown choice in one line."""
    _refuse_unless(value in choices, field, value, f"choose one of {', '.join(choices)}")


def _refuse_unless(valid: bool, field: str, value: object, cure: str) -> None:
    """Refuse a bad setting in one line."""
    if not valid:
        raise ValueError(f"model: {field} = {value!r} is not usable; {cure}")
