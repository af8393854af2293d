"""The disturbance of the linear model over one period of the sampled, slipping robot, by cause.

    e+ = f(e_m - n, v_a, w_a) + n+        w = e+ - A(th) e_m - B(th) u

    f:  z+ = e^{-ia} z + T V S(A) e^{i (e_th + A - a)} - T v S(a),   z = e_x + i e_y
        e_th+ = e_th + A - a,    a = T w,    A = T Om
        S(a) = (1 - e^{-ia}) / (ia) = sinc(a/2) e^{-ia/2}

Commands (v, w) come from the measured error e_m and the inputs (u1, u2) by an input map; all have w
= Om - u2:

    paper         v = V - u1
    cosine_free   v = V cos e_th - u1
    x_exact       v such that e_x+ = e_x + T Om e_y + T u1 without slip and noise

Ground speeds g_r = v + b w/2, g_l = v - b w/2 act as g_r (1 - d_r), g_l (1 - d_l). The heading
this adds is the yaw kick kappa = T (w - w_a) = T (g_r d_r - g_l d_l) / b. The body also moves to
the left at v_y = zeta v_a - r w_a, with a sideslip zeta and a lever arm r, which adds -i T v_y
S(a_a) to z+. With f(e, u) the plant without slip, sideslip and noise, and J its Jacobian at
e = u = 0,

    w = kappa (0, g_y, 1) + bilinear + sine + sampling + slip + sideslip + noise
    sine = f(e, 0) - J (e, 0)
    bilinear = f(e, u) - J (e, u) - sine
    sampling = (J - [A B]) (e, u)
    slip = f(e, v_a, w_a) - f(e, v, w) - kappa (0, g_y, 1)
    sideslip = -i T v_y S(a_a)
    noise = the rest, n+ left out

and each part is written so that its enclosure by intervals vanishes with its cause. A sideslip that
varies within the period adds no more to either coordinate than the extreme constant one does: there
-i e^{-i w_a t} keeps the signs of its parts. Every function
takes floats, intervals and duals alike. All angles stay within a quarter turn.

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (2)-(6), (9)-(10); the arcs solve eqs. (2) and
(4) exactly.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from sets.interval import cos, lag, sin, sinc, sinc_change, sine_excess, square

INPUT_MAPS = ("paper", "cosine_free", "x_exact")
MODELS = ("paper", "consistent", "exact_jacobian")
DISCRETISATIONS = ("euler", "zoh")


@dataclass(frozen=True)
class Kinematics:
    """How inputs become commands and how the model predicts.

    Attributes:
        input_map: one of INPUT_MAPS.
        model: "paper" takes Om = (f_r V_r - f_l V_l) / b, "consistent" the same with f = 1;
            "exact_jacobian" is the Jacobian of the sampled plant under `x_exact`.
        discretisation: "euler" or "zoh", inputs held; of no effect on "exact_jacobian".
        slip_factors: (f_r, f_l), 1 - nominal slip; of effect on "paper" only.
    """

    input_map: str = "x_exact"
    model: str = "exact_jacobian"
    discretisation: str = "euler"
    slip_factors: tuple[float, float] = (1.0, 1.0)

    def __post_init__(self):
        choices = (
            ("input_map", INPUT_MAPS),
            ("model", MODELS),
            ("discretisation", DISCRETISATIONS),
        )
        for name, allowed in choices:
            if getattr(self, name) not in allowed:
                raise ValueError(
                    f"{name}: {getattr(self, name)!r} is unknown; "
                    f"choose one of {', '.join(allowed)}"
                )

    def predicts_like(self, other: Kinematics) -> bool:
        """Return whether both choose the same model, by name."""
        if self.model != other.model:
            return False
        return self.model == "exact_jacobian" or self.discretisation == other.discretisation


class Late(NamedTuple):
    """What wheels that lag add to a period (`sets.robot.committed`).

    Attributes:
        lever: by how much further, m/rad, the slip of a period moves the robot sideways than it
            would at once, for it turns what is still on its way.
        speed, yaw_rate: what unknown lag and delay take from the body at most, m/s and rad/s.
    """

    lever: float
    speed: float
    yaw_rate: float


class Period(NamedTuple):
    """Length of a period dt, s, track width, m, lateral_per_yaw g_y, m/rad, and lever arm r, m; and
    of wheels that lag what that adds, the lever of its own in g_y."""

    dt: float
    track_width: float
    lateral_per_yaw: float
    lever_arm: float = 0.0
    late: Late | None = None


class Vector(NamedTuple):
    """A plane vector whose coordinates are floats, intervals or duals; a coordinate that is always
    zero may be 0.0."""

    x: Any
    y: Any

    def plus(self, other: Vector) -> Vector:
        """Return the sum."""
        return Vector(self.x + other.x, self.y + other.y)

    def scaled(self, factor) -> Vector:
        """Return the vector times a number."""
        return Vector(self.x * factor, self.y * factor)

    def stretched(self, factors: Sequence[float]) -> Vector:
        """Return the vector with each coordinate times its own number; factors of 1 leave it as it
        is, to the last bit."""
        of_x, of_y = factors
        x = self.x if of_x == 1 else self.x * of_x
        y = self.y if of_y == 1 else self.y * of_y
        return Vector(x, y)

    def turned(self, angle) -> Vector:
        """Return the vector turned to the left, rad."""
        c = cos(angle)
        s = sin(angle)
        return Vector(self.x * c - self.y * s, self.x * s + self.y * c)

    def crosswise(self) -> Vector:
        """Return the vector turned to the left by a right angle."""
        return Vector(-self.y, self.x)


class Parts(NamedTuple):
    """The yaw kick, rad, the parts of w in the plane, m, and the commanded ground speeds, m/s."""

    yaw: Any
    bilinear: Vector
    sine: Vector
    sampling: Vector
    slip: Vector
    sideslip: Vector
    noise: Vector
    right: Any
    left: Any

    @property
    def rest(self) -> Vector:
        """The parts of w beside the yaw kick and the noise of the next measurement."""
        return self.rest_under((1.0, 1.0))

    def rest_under(self, gain: Sequence[float]) -> Vector:
        """Return the same where an estimate takes over a share of what it did not predict.

        Args:
            gain: share (longitudinal, lateral) of slip, sideslip and noise.
        """
        model = self.bilinear.plus(self.sine).plus(self.sampling)
        sliding = model.plus(self.slip.stretched(gain)).plus(self.sideslip.stretched(gain))
        return sliding.plus(self.noise.stretched(gain))

    @property
    def unpredicted(self) -> Vector:
        """What the plant without slip, sideslip and noise does not predict of the next true error,
        beside the yaw kick."""
        return self.slip.plus(self.sideslip).plus(self.noise)


def split_disturbance(kinematics: Kinematics, period: Period, variables: Iterable) -> Parts:
    """Split the disturbance w of the model by cause.

    Args:
        kinematics, period: what maps, predicts and measures.
        variables: measured error (m, m, rad), inputs (m/s, rad/s), reference wheel speeds (right,
            left), m/s, wheel errors d (right, left), sideslip zeta, pose noise n (m, m, rad):
            thirteen numbers of one kind. Of wheels that lag d are speeds that they lose, m/s, and
            the (speed m/s, yaw rate rad/s) that lag and delay take from the body come last.

    Returns:
        The parts; with the noise n+ of the next measurement, w = rest + yaw (0, g_y) + n+ in the
        plane, and in heading w = yaw - n + n+ exactly.

    Raises:
        ValueError: an angle of an interval may leave a quarter turn.
    """
    x, y, heading, u1, u2, V_r, V_l, d_r, d_l, zeta, n_x, n_y, n_th, *taken = variables
    T, b, g_y, r, late = period
    z = Vector(x, y)
    A = (V_r - V_l) * T / b
    L = (V_r + V_l) * 0.5 * T
    m = u2 * T
    a = A - m
    if kinematics.input_map == "x_exact":
        bilinear, sine, Tv = _split_x_exact(z, heading, u1 * T, m, A, L)
    else:
        is_cosine_free = kinematics.input_map == "cosine_free"
        bilinear, sine, Tv = _split_direct(z, heading, u1 * T, m, A, L, is_cosine_free)
    sampling = _compute_sampling(kinematics, period, (x, y, heading, u1, u2), V_r, V_l)

    right = Tv + a * (0.5 * b)
    left = Tv - a * (0.5 * b)
    if late is None:
        kick = (right * d_r - left * d_l) / b
        brake = (right * d_r + left * d_l) * 0.5
        lever = 0.0
    else:
        speed_taken, yaw_rate_taken = taken
        kick = (d_r - d_l) * T / b + yaw_rate_taken * T
        brake = (d_r + d_l) * (0.5 * T) + speed_taken * T
        lever = late.lever
    # Where the reference goes, in the frame of a robot that turned by a.
    reference = polar(L * sinc(A * 0.5), heading + m - A * 0.5)
    swept = z.turned(kick * 0.5 - a).plus(reference.turned(kick * 0.5))
    turn = swept.crosswise().scaled(sin(kick * 0.5) * 2.0)
    way = arc(a - kick).scaled(brake).plus(arc_change(a, -kick).scaled(-Tv))
    slip = turn.plus(way).plus(Vector(0.0, kick * (lever - g_y)))

    sideways = zeta * (Tv - brake) - (a - kick) * r
    sideslip = arc(a - kick).crosswise().scaled(-sideways)

    shift = Vector(-n_x, -n_y).turned(kick - a)
    swing = reference.turned(kick - n_th * 0.5).crosswise()
    noise = shift.plus(swing.scaled(sin(n_th * 0.5) * -2.0))
    return Parts(kick, bilinear, sine, sampling, slip, sideslip, noise, right / T, left / T)


def polar(length, angle) -> Vector:
    """Return the vector of given length, m, and angle, rad."""
    return Vector(length * cos(angle), length * sin(angle))


def arc(angle) -> Vector:
    """Return S(a), the mean of e^{-iat} over t in [0, 1]."""
    return polar(sinc(angle * 0.5), angle * -0.5)


def arc_change(angle, step) -> Vector:
    """Return S(a + step) - S(a)."""
    half = angle * 0.5
    change = step * 0.5
    stretch = polar(sinc_change(half, change), -half - change)
    turn = polar(sinc(half) * sin(change * 0.5) * -2.0, -half - change * 0.5)
    return stretch.plus(turn.crosswise())


def _split_x_exact(z: Vector, heading, Tu1, m, A, L) -> tuple[Vector, Vector, Any]:
    """Return (bilinear, sine, T v) of `x_exact`, from e_y+ = e_y - tan(a/2) q + L s sin(e_th + m/2)
    / cos(a/2).

    q = e_x + e_x+; the Jacobian has A and e_th + m/2 in the place of a and the sine.
    """
    a = A - m
    length = L * sinc(A * 0.5)
    secant_a = 1.0 / cos(a * 0.5)
    secant_A = 1.0 / cos(A * 0.5)
    q = z.x * 2.0 + A * z.y + Tu1
    # tan(A/2) - tan(a/2)
    tangents = sin(m * 0.5) * secant_a * secant_A
    # 1/cos(a/2) - 1/cos(A/2)
    secants = sin((A - m * 0.5) * 0.5) * sin(m * 0.25) * -2.0 * secant_a * secant_A
    # sin(e_th + m/2) - sin(e_th) - m/2
    half_turn = square(sin((heading + m * 0.25) * 0.5))
    sines = sine_excess(m * 0.25) * 2.0 - sin(m * 0.25) * half_turn * 4.0
    lateral = secants * sin(heading + m * 0.5) + secant_A * sines
    bilinear = tangents * q + length * lateral
    sine = length * secant_A * sine_excess(heading)
    ahead = length * cos(heading + A * 0.5 - a)
    ahead = ahead - square(sin(a * 0.5)) * 2.0 * z.x
    ahead = ahead + (sine_excess(a) - m) * z.y - Tu1
    return Vector(0.0, bilinear), Vector(0.0, sine), ahead * secant_a / sinc(a * 0.5)


def _split_direct(
    z: Vector, heading, Tu1, m, A, L, is_cosine_free: bool
) -> tuple[Vector, Vector, Any]:
    """Return (bilinear, sine, T v) of `cosine_free`, and of `paper`, which drives L (1 - cos e_th)
    further."""
    # 1 - cos e_th
    versine = square(sin(heading * 0.5)) * 2.0
    change = arc_change(A, -m)
    chord = polar(sinc(A * 0.5), A * -0.5)
    # (e^{im} - 1) S(A)
    swing = polar(sinc(A * 0.5) * sin(m * 0.5) * 2.0, (m - A) * 0.5).crosswise()
    sway = swing.plus(change.scaled(-1.0))
    # -im R(A), R of the Jacobian
    drift = Vector(m * -lag(A), m * square(sinc(A * 0.5)) * -0.5)
    reference = sway.plus(drift).plus(sway.scaled(-versine))
    reference = reference.plus(swing.crosswise().scaled(sin(heading)))
    turn = z.turned(m * 0.5 - A).crosswise().scaled(sin(m * 0.5) * 2.0)
    bilinear = turn.plus(change.scaled(Tu1)).plus(reference.scaled(L))
    sine = chord.crosswise().scaled(L * sine_excess(heading))
    if is_cosine_free:
        return bilinear, sine, L * (1.0 - versine) - Tu1
    further = L * versine
    return bilinear.plus(change.scaled(-further)), sine.plus(chord.scaled(-further)), L - Tu1


def _compute_sampling(kinematics: Kinematics, period: Period, terms: Sequence, V_r, V_l) -> Vector:
    """Return (J - [A B]) (e, u)."""
    model = "exact_jacobian" if kinematics.input_map == "x_exact" else "consistent"
    jacobian = Kinematics(kinematics.input_map, model, "zoh")
    if jacobian.predicts_like(kinematics):
        return Vector(0.0, 0.0)
    x, y, heading, u1, u2 = terms
    L = (V_r + V_l) * 0.5 * period.dt
    scaled = (x, y, heading * L, u1, u2 * L)
    own_x, own_y = plane_rows(jacobian, period, V_r, V_l)
    model_x, model_y = plane_rows(kinematics, period, V_r, V_l)
    return Vector(
        _multiply_difference(own_x, model_x, scaled), _multiply_difference(own_y, model_y, scaled)
    )


def _multiply_difference(left: Sequence, right: Sequence, terms: Sequence):
    """Return (left - right) . terms."""
    triples = zip(left, right, terms, strict=True)
    return sum((p - q) * term for p, q, term in triples)


def plane_rows(kinematics: Kinematics, period: Period, V_r, V_l) -> tuple[Sequence, Sequence]:
    """Return the first two rows of [A B], columns (e_x, e_y, L e_th, u1, L u2), L = T V; the third
    is (0, 0, 1, 0, T).

    The way L stands apart because it cancels where models are compared.

    Args:
        kinematics, period: which model, s and m.
        V_r, V_l: reference wheel speeds, m/s.

    Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (6), (9)-(10) for "euler".
    """
    T = period.dt
    b = period.track_width
    if kinematics.model == "exact_jacobian":
        A = (V_r - V_l) * T / b
        secant = 1.0 / cos(A * 0.5)
        h = sin(A * 0.5) * secant
        c = sinc(A * 0.5) * secant
        return (1.0, A, 0.0, T, 0.0), (h * -2.0, 1.0 - h * A, c, h * -T, c * 0.5 * T)
    f_r, f_l = kinematics.slip_factors if kinematics.model == "paper" else (1.0, 1.0)
    A = (V_r * f_r - V_l * f_l) * T / b
    if kinematics.discretisation == "euler":
        return (1.0, A, 0.0, T, 0.0), (-A, 1.0, 1.0, 0.0, 0.0)
    # S(A), and R(A) = (1 - S) / (iA) = sinc(A/2)^2 / 2 - i lag(A)
    S = arc(A)
    c = cos(A)
    s = sin(A)
    x_row = (c, s, -S.y, S.x * T, lag(A) * T)
    y_row = (-s, c, S.x, S.y * T, square(sinc(A * 0.5)) * 0.5 * T)
    return x_row, y_row
