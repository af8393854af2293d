"""The set that holds the error of an estimate of the tracking error, whatever slip and noise do.

A controller that acts on the measured error y meets its whole noise anew in every period, and what
the noise of one period did leaves again in the next: the faster the sampling, the more of both. An
estimate p takes over only a share L = diag(l_x, l_y, l_th), 0 < l <= 1, of what it did not predict:

    p-  = f(p, v, w)                       the sampled plant without slip, sideslip and noise
    p+  = p- + L (y+ - p-)                 y+ = e+ + n+,  |n+| <= nu
    e+  = p- + r                           r = kappa (0, g_y, 1) + slip + sideslip + noise

with the parts of `sets.robot.plant` at measured error p and pose noise n = p - e, in heading -n_th.
Hence p+ = p- + L (r + n+), the disturbance of `sets.robot.disturbance`, and

    n+ = p+ - e+ = -(I - L) r + L n+

A box S holds n for ever, under any sequence of slips, inputs and references, where

    (I - L) sup {|r| : |n| <= S} + L nu  <=  S,        nu <= S,

for the first estimate is the first measurement. In heading r = kappa - n_th alone, and the least
such S is nu_th + (1 / l_th - 1) sup |kappa|; along and across it is near a
fixed point of errors that are attained, found by Newton's method with the turn of the robot as the
slope. What is returned is a little larger, and its inclusion was proved by intervals. For L = I,
S = nu.

Source: new; a Luenberger observer whose error is kept in a robust invariant set goes back to Mayne,
Rakovic, Findeisen, Allgoewer 2006, Automatica 42(7), section 3.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from sets.robot.driving import commit_operation
from sets.robot.operation import FINE, Operation
from sets.robot.plant import Kinematics, split_disturbance
from sets.supremum import MOST_CELLS, suprema

TOLERANCE = 1e-4
"""Relative gap of the bounds: errors of an estimate sum up 1 / l of them."""
MARGIN = 3e-3
"""Share by which S is larger than the fixed point; more if that takes long."""
MOST_STEPS = 10
"""Evaluations before a gain is given up."""
SETTLED = 3e-4
"""Relative change at which the fixed point of errors that are attained is known well enough for
proofs to begin there."""
FEW_CELLS = 2000
"""Cells after which a search for values that are attained ends, which proves little."""


def find_estimate_error(operation: Operation, kinematics: Kinematics) -> Float[np.ndarray, "3"]:
    """Return half widths S (m, m, rad) of a box that the error of the estimate never leaves, proved
    by intervals.

    Args:
        operation: where the robot works; `errors` are the estimated ones, `estimate_error` is not
            read.
        kinematics: input map; the model does not count.

    Raises:
        ValueError: no box was found, for a gain is too small for the turns of the robot; or an
            angle may leave a quarter turn.
    """
    if min(operation.gain) == 1:
        return operation.noise
    gain = np.array(operation.gain)
    unpredicted = _find_unpredicted(operation, kinematics)
    slopes = (1 - gain[:2, None]) * _slopes(operation)
    if np.max(np.abs(np.linalg.eigvals(slopes))) >= 1:
        raise ValueError(
            f"gain: {operation.gain} lets errors grow by turning; give shares nearer to 1"
        )
    size = _estimate_fixed_point(unpredicted, slopes, kinematics) * (1 + MARGIN)
    for step in range(MOST_STEPS):
        margin = MARGIN * 2 ** max(step - 3, 0)
        image = _bound_image(unpredicted, size, kinematics)
        fixed = _take_newton_step(size, image, slopes, operation)
        if np.all(image <= size) and np.all(size <= fixed * (1 + 2 * margin)):
            return size
        size = fixed * (1 + margin)
    raise ValueError(f"gain: {operation.gain} leads to no bounded error; give shares nearer to 1")


def _estimate_fixed_point(
    unpredicted: _Unpredicted, slopes: Float[np.ndarray, "2 2"], kinematics: Kinematics
) -> Float[np.ndarray, "3"]:
    """Return the fixed point, nearly, of errors that are attained: proofs that begin there seldom
    need a second step."""
    size = unpredicted.operation.noise
    for _ in range(MOST_STEPS):
        _, found = _image(unpredicted, size, kinematics, FEW_CELLS)
        fixed = _take_newton_step(size, found, slopes, unpredicted.operation)
        if np.all(np.abs(fixed - size) <= SETTLED * size):
            return fixed
        size = fixed
    return size


def _take_newton_step(
    size: Float[np.ndarray, "3"],
    image: Float[np.ndarray, "3"],
    slopes: Float[np.ndarray, "2 2"],
    operation: Operation,
) -> Float[np.ndarray, "3"]:
    """Return Newton's next size, from a size and its image."""
    change = image - size
    along = np.linalg.solve(np.eye(2) - slopes, change[:2])
    return np.maximum(size + np.append(along, change[2] / operation.gain[2]), operation.noise)


def _slopes(operation: Operation) -> Float[np.ndarray, "2 2"]:
    """Return how errors in the plane go on to the next period at most, by coordinate: the robot
    turns under them."""
    differences = operation.box[::-1, 5] - operation.box[:, 6]
    yaw_rate = np.abs(differences).max() / operation.track_width
    yaw_rate += np.abs(operation.inputs[:, 1]).max()
    turn = np.sin(min(operation.dt * yaw_rate, np.pi / 2))
    return np.array([[1.0, turn], [turn, 1.0]])


class _Unpredicted(NamedTuple):
    """An operation, and what else is unpredicted of wheels that lag: half widths (m, m) and the
    greatest yaw kick, rad."""

    operation: Operation
    added: Float[np.ndarray, "2"]
    kick: float


def _find_unpredicted(operation: Operation, kinematics: Kinematics) -> _Unpredicted:
    if operation.actuation.is_ideal:
        return _Unpredicted(operation, np.zeros(2), np.inf)
    committed, commitment = commit_operation(operation, kinematics)
    return _Unpredicted(committed, commitment.box + commitment.slide, commitment.kick)


def bound_next_error(operation: Operation, kinematics: Kinematics) -> Float[np.ndarray, "3"]:
    """Return a proved bound (m, m, rad) of the estimate's error a period later, where it is within
    `operation.estimate_error` now.

    Raises:
        ValueError: an angle may leave a quarter turn.
    """
    assert operation.estimate_error is not None
    unpredicted = _find_unpredicted(operation, kinematics)
    return _bound_image(unpredicted, operation.estimate_error, kinematics)


def _bound_image(
    unpredicted: _Unpredicted, size: Float[np.ndarray, "3"], kinematics: Kinematics
) -> Float[np.ndarray, "3"]:
    """Return `bound_next_error` of an error within a box of this size."""
    proved, _ = _image(unpredicted, size, kinematics, MOST_CELLS)
    return proved * (1 + 8 * np.finfo(float).eps)


def _image(
    unpredicted: _Unpredicted,
    size: Float[np.ndarray, "3"],
    kinematics: Kinematics,
    most_cells: int,
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Return (what is proved, what was found) to be the greatest error (m, m, rad) a period after
    one within a box of this size, before rounding."""
    operation = replace(unpredicted.operation, estimate_error=size)
    # The slip with what its yaw kick moves sideways, which W has apart.
    period = operation.period._replace(lateral_per_yaw=0.0)

    def outputs(piece):
        parts = split_disturbance(kinematics, period, operation.variables(piece))
        return (*parts.unpredicted, parts.yaw)

    lower, upper = operation.pieces()
    objectives = [(output, sign, output) for output in range(3) for sign in (1, -1)]
    negligible = FINE * np.array([operation.travel, operation.travel, 1.0])
    ends = suprema(outputs, lower, upper, objectives, TOLERANCE, negligible, most_cells)
    left = 1 - np.array(operation.gain)
    images = []
    for unpredicted_most in ends:
        most = unpredicted_most.copy()
        most[:2] += unpredicted.added
        most[2] = min(most[2], unpredicted.kick) + size[2]
        images.append(left * most + operation.gain * operation.noise)
    return images[0], images[1]
