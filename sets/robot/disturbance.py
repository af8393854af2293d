"""The set W that holds every disturbance of the nonlinear, sampled, slipping robot over an
operating set.

    w = e_m+ - A(th) e_m - B(th) u  in  W = {sigma (0, g_y, 1) : |sigma| <= yaw} + box

whenever measured errors e_m, inputs u, reference wheel speeds th and wheel errors d lie in their
boxes, the sideslip satisfies |zeta| <= s and the pose noise |n| <= nu, now and after. A yaw kick
sigma also moves the robot sideways by g_y sigma, g_y = T V / 2 at the centre of the schedule, which
is why W is a segment plus a box and not a larger box. The bounds are proved by interval arithmetic
rounded outwards, and come with the largest values found.

A controller may act on an estimate p of the error in the place of e_m (`sets.robot.observer`),
which takes over the share L = diag(l_x, l_y, l_th) of what it did not predict. With n = p - e,
|n| <= S, and the noise n+ of the next measurement, |n+| <= nu,

    w = p+ - A p - B u
      = bilinear + sine + sampling + L (kappa (0, g_y, 1) + slip + sideslip + noise + n+)

where `noise` is that of n, in heading -n_th. The kick runs along (0, l_y g_y, l_th): g_y becomes
g_y l_y / l_th, and the yaw kick l_th times itself. L = I, S = nu is the measured error itself.

Notation and the parts of w: `sets.robot.plant`. Source: the idea of a computed W follows Gonzalez,
Fiacchini, Guzman, Alamo 2009, section III, where W is given; the bound itself is new.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import chain, product

import numpy as np
from jaxtyping import Float

from sets.polytope import Polytope, hull_vertices
from sets.robot.actuation import NO_LAG
from sets.robot.driving import commit_operation
from sets.robot.operation import COARSE, FINE, Operation
from sets.robot.plant import Kinematics, Parts, split_disturbance
from sets.supremum import suprema

UNCERTAIN_SLIPS = ("true", "measured", "both")
CAUSES = ("bilinear", "sine", "sampling", "slip", "sideslip", "noise")


@dataclass(frozen=True, eq=False)
class DisturbanceBound:
    """W = {sigma (0, lateral_per_yaw, 1) : |sigma| <= yaw} + box, and what reaches into it.

    Attributes:
        yaw: largest yaw kick, rad.
        lateral_per_yaw: g_y, m/rad.
        box: half widths (m, m, rad).
        ground_speeds: commanded ones, (lower, upper) by (right, left), m/s.
        found_yaw, found_box: values that are attained; the least bounds lie between them and W.
    """

    yaw: float
    lateral_per_yaw: float
    box: Float[np.ndarray, "3"]
    ground_speeds: Float[np.ndarray, "2 2"]
    found_yaw: float
    found_box: Float[np.ndarray, "3"]

    def support(self, directions: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Return the support numbers of W along the rows of `directions`, exact up to rounding."""
        along_kick = directions @ np.array([0.0, self.lateral_per_yaw, 1.0])
        return self.yaw * np.abs(along_kick) + np.abs(directions) @ self.box

    def vertices(self) -> Float[np.ndarray, "v 3"]:
        """Return the extreme points of W, at most twelve."""
        signs = np.array(np.meshgrid(*[[-1.0, 1.0]] * 4)).reshape(4, -1).T
        kick = np.array([0.0, self.lateral_per_yaw, 1.0])
        kicks = signs[:, 3:] * self.yaw * kick
        return hull_vertices(signs[:, :3] * self.box + kicks)

    def polytope(self) -> Polytope:
        """Return W by its eight facets, rounded outwards: the box and the strip along the kicks."""
        normals = np.vstack([np.eye(3), [0.0, 1.0, -self.lateral_per_yaw]])
        normals = np.vstack([normals, -normals])
        return Polytope(normals, _round_up(self.support(normals)))


def _round_up(magnitudes: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """Return numbers above those that were rounded a few times."""
    return np.nextafter(magnitudes * (1 + 8 * np.finfo(float).eps), np.inf)


def wheel_error_bound(
    nominal_slip: Float[np.ndarray, "2"], relative_error: float, uncertain_slip: str
) -> Float[np.ndarray, "2"]:
    """Return the largest |d|, d = (i - i_m) / (1 - i_m), of each wheel; it is attained.

    Args:
        nominal_slip: i0 of each wheel.
        relative_error: r, not negative.
        uncertain_slip: which slip lies in i0 (1 +- r), the other being i0: "true" i, "measured"
            i_m; or "both" do.

    Raises:
        ValueError: a slip may reach 1, or an argument is out of range.

    Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (7)-(8) for the division by 1 - i_m.
    """
    nominal_slip = np.asarray(nominal_slip, dtype=float)
    if uncertain_slip not in UNCERTAIN_SLIPS:
        raise ValueError(
            f"random: {uncertain_slip!r} is unknown; choose one of {', '.join(UNCERTAIN_SLIPS)}"
        )
    if not 0 <= relative_error < np.inf:
        raise ValueError(
            f"relative_error: {relative_error} is negative or not finite; give a share such as 0.1"
        )
    if not (np.abs(nominal_slip) * (1 + relative_error) < 1).all():
        raise ValueError(
            f"nominal_slip: {nominal_slip} (1 + {relative_error}) reaches 1; lower one of them"
        )
    largest = [_find_largest_error(slip, relative_error, uncertain_slip) for slip in nominal_slip]
    return _round_up(np.array(largest))


def _find_largest_error(nominal_slip: float, relative_error: float, uncertain_slip: str) -> float:
    """Return the largest |d| of a wheel; in fractions, for i - i_m is a small difference."""
    slip = Fraction(nominal_slip)
    ends = [slip * (1 - Fraction(relative_error)), slip * (1 + Fraction(relative_error))]
    true = [slip] if uncertain_slip == "measured" else ends
    measured = [slip] if uncertain_slip == "true" else ends
    # d grows with i and falls with i_m, so its extremes lie at ends of both.
    return float(max(abs(i - i_m) / (1 - i_m) for i, i_m in product(true, measured)))


def wheel_error_range(
    slips: Float[np.ndarray, "k 2 2"],
) -> Float[np.ndarray, "2 2"]:
    """Return the box (lower, upper) of d = (i - i_m) / (1 - i_m) of each wheel, rounded outwards.

    Args:
        slips: (true, measured) slips (right, left) at the extremes, measured ones below 1.

    Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (7)-(8) for the division by 1 - i_m.
    """
    true, measured = np.swapaxes(slips, 0, 1)
    left = 1 - measured
    errors = (true - measured) / left
    # Of a small difference the slips themselves, which were rounded, leave most.
    sizes = np.abs(errors) + (np.abs(true) + np.abs(measured)) / left
    rounding = 8 * np.finfo(float).eps * sizes
    return np.stack([(errors - rounding).min(axis=0), (errors + rounding).max(axis=0)])


def disturbance_bound(
    operation: Operation, kinematics: Kinematics, tolerance: float = 0.003
) -> DisturbanceBound:
    """Bound the disturbances of an operation.

    Args:
        operation: where the robot works.
        kinematics: input map and model.
        tolerance: gap between bounds and values found at which a bound is good enough, relative,
            positive.

    Returns:
        W, which holds every w of the operation: proved by intervals, up to the rounding of its own
        facets.

    Raises:
        ValueError: an angle may leave a quarter turn, in which the bounds hold, or lag and delay do
            too much.
    """
    if not operation.actuation.is_ideal:
        return _bound_late_disturbance(operation, kinematics, tolerance)
    period = operation.period

    def outputs(piece):
        parts = split_disturbance(kinematics, period, operation.variables(piece))
        return parts.yaw, *parts.rest_under(operation.gain[:2]), parts.right, parts.left

    lower, upper = operation.pieces()
    both_signs = [(output, sign, output) for output in (0, 1, 2) for sign in (1, -1)]
    ends = [(3, -1, 3), (4, -1, 4), (3, 1, 5), (4, 1, 6)]
    units = [1.0, *[operation.travel] * 2, *[operation.speed] * 4]
    negligible = FINE * np.array(units)
    proved, found = suprema(outputs, lower, upper, both_signs + ends, tolerance, negligible)
    box = _add_measurement(operation, proved[1:3])
    if min(operation.gain) < 1:
        box[1] += _kick_rounding(operation, float(proved[0]))
        box = _round_up(box)
    return DisturbanceBound(
        yaw=_share_of_kick(operation, float(proved[0])),
        lateral_per_yaw=operation.kick_per_yaw,
        box=np.nextafter(box, np.inf),
        ground_speeds=np.array([-proved[3:5], proved[5:7]]),
        found_yaw=float(operation.gain[2] * found[0]),
        found_box=_add_measurement(operation, found[1:3]),
    )


def _bound_late_disturbance(
    operation: Operation, kinematics: Kinematics, tolerance: float
) -> DisturbanceBound:
    """Bound the disturbances of the committed pose.

    While commands do not change, wheels that lag are wheels that obey at once: what is found for
    those is attained.
    """
    ideal = disturbance_bound(replace(operation, actuation=NO_LAG), kinematics, tolerance)
    committed, commitment = commit_operation(operation, kinematics)
    bound = disturbance_bound(committed, kinematics, tolerance)
    late = np.append(operation.gain[:2] * (commitment.box + commitment.slide), 0.0)
    return replace(
        bound,
        yaw=min(bound.yaw, _share_of_kick(operation, commitment.kick)),
        box=_round_up(bound.box + late),
        found_yaw=ideal.found_yaw,
        found_box=ideal.found_box,
    )


def _share_of_kick(operation: Operation, yaw: float) -> float:
    """Return how far a yaw kick turns the estimate, rad, rounded up; all of it turns what is
    measured."""
    share = operation.gain[2]
    return yaw if share == 1 else float(np.nextafter(share * yaw, np.inf))


def _kick_rounding(operation: Operation, yaw: float) -> float:
    """Return by how much a kick leaves the direction of W's segment sideways, m, for that direction
    is a rounded one."""
    _, of_y, of_heading = map(Fraction, operation.gain)
    exact = of_y * Fraction(operation.period.lateral_per_yaw)
    gap = abs(exact - of_heading * Fraction(operation.kick_per_yaw))
    return float(np.nextafter(float(gap), np.inf)) * yaw


def _add_measurement(operation: Operation, plane: Float[np.ndarray, "2"]) -> Float[np.ndarray, "3"]:
    """Return the half widths of the box: the next measurement's noise enters everywhere, in heading
    beside the error of the present estimate."""
    assert operation.estimate_error is not None
    x, y, heading = operation.gain * operation.noise
    turned = operation.gain[2] * operation.estimate_error[2]
    return np.array([plane[0] + x, plane[1] + y, turned + heading])


def disturbance_parts(
    operation: Operation, kinematics: Kinematics
) -> dict[str, Float[np.ndarray, "4"]]:
    """Bound what each cause adds to W alone, as half widths (yaw rad, x m, y m, heading rad).

    Args:
        operation, kinematics: as for `disturbance_bound`.

    Returns:
        By cause, bounds of differences that add up to w, within 2 % of their suprema or 1e-4 of
        the way that the reference goes in a period, unless a search was cut short (f the sampled
        plant without slip and noise, J its Jacobian at e = u = 0):

        * "bilinear": f(e, u) - J (e, u) minus the same at u = 0, products of inputs with errors
          and inputs;
        * "sine": f(e, 0) - J (e, 0), sine and cosine of the heading error;
        * "sampling": (J - [A B]) (e, u), the linear part that the model misses, by its time steps
          or its slip factors;
        * "slip": f at the acting minus f at the commanded speeds; the yaw kick stands apart, its
          g_y taken off y;
        * "sideslip": the body's lateral motion, by sideslip and lever arm;
        * "lag": lag and delay of the wheels, unknown parts and the order of motions;
        * "noise": the acting step from the true instead of the measured error, and the next
          measurement.

        Of the last three an estimate takes over its gain times as much.

    Raises:
        ValueError: as `disturbance_bound`.
    """
    if not operation.actuation.is_ideal:
        return _late_parts(operation, kinematics)
    period = operation.period

    def outputs(piece):
        parts: Parts = split_disturbance(kinematics, period, operation.variables(piece))
        vectors = [getattr(parts, cause) for cause in CAUSES]
        vectors[3:] = [vector.stretched(operation.gain[:2]) for vector in vectors[3:]]
        return parts.yaw, *chain.from_iterable(vectors)

    lower, upper = operation.pieces()
    count = 1 + 2 * len(CAUSES)
    objectives = [(output, sign, output) for output in range(count) for sign in (1, -1)]
    negligible = COARSE * np.array([1.0, *[operation.travel] * (count - 1)])
    proved, _ = suprema(outputs, lower, upper, objectives, 0.02, negligible, most_cells=20_000)
    yaw, *plane = proved
    widths = {}
    for cause, half_widths in zip(CAUSES, np.reshape(plane, (-1, 2)), strict=True):
        widths[cause] = np.array([0.0, *half_widths, 0.0])
    widths["slip"][0] = _share_of_kick(operation, float(yaw))
    widths["noise"][1:] += _add_measurement(operation, np.zeros(2))
    widths["lag"] = np.zeros(4)
    return widths


def _late_parts(operation: Operation, kinematics: Kinematics) -> dict[str, Float[np.ndarray, "4"]]:
    """Return `disturbance_parts` of wheels that lag; what of the yaw kick is unknown lag and delay
    stands with them."""
    committed, commitment = commit_operation(operation, kinematics)
    widths = disturbance_parts(committed, kinematics)
    unknown = _share_of_kick(operation, operation.dt * float(commitment.unknown[1]))
    most = min(widths["slip"][0], _share_of_kick(operation, commitment.kick))
    widths["slip"][0] = max(most - unknown, 0.0)
    widths["lag"] = np.array([unknown, *(operation.gain[:2] * commitment.box), 0.0])
    widths["sideslip"][1:3] = operation.gain[:2] * commitment.slide
    return widths


def evaluate_disturbance(
    operation: Operation,
    kinematics: Kinematics,
    points: Float[np.ndarray, "samples 13"],
    next_noise: Float[np.ndarray, "samples 3"],
) -> tuple[
    Float[np.ndarray, "samples 3"], Float[np.ndarray, " samples"], Float[np.ndarray, "samples 2"]
]:
    """Evaluate disturbances, as the bounds do.

    Args:
        operation: gives dt, track width, g_y and gain; its boxes are not consulted.
        kinematics: input map and model.
        points: the thirteen variables of `split_disturbance`.
        next_noise: noise of the measurement after the period (m, m, rad).

    Returns:
        w (m, m, rad), yaw kicks, rad, and commanded ground speeds (right, left), m/s; exact up to
        rounding.
    """
    _, of_y, of_heading = operation.gain
    parts = split_disturbance(kinematics, operation.period, points.T)
    rest = parts.rest_under(operation.gain[:2])
    lateral = rest.y + of_y * operation.period.lateral_per_yaw * parts.yaw
    heading = of_heading * (parts.yaw - points[:, -1])
    w = np.stack([rest.x, lateral, heading], axis=-1) + operation.gain * next_noise
    return w, parts.yaw, np.stack([parts.right, parts.left], axis=-1)
