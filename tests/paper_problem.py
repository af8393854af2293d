"""The data of Gonzalez, Fiacchini, Guzman, Alamo 2009, section IV, in plain numpy: what the tests
of `sets` work on."""

import functools
import itertools

import numpy as np

from sets.lmi import Objective, terminal_cost
from sets.polytope import Polytope
from sets.riccati import lqr_gain

PERIOD = 0.1
TRACK = 0.5
GRIP = 0.8
FASTEST = 1.5
INPUT = PERIOD * np.array([[1.0, 0.0], [0.0, 0.0], [0.0, 1.0]])
PAPER = (np.diag([1.0, 1.0, 0.01]), np.eye(2))
LATERAL = (np.diag([1.0, 3.0, 1.0]), 0.3 * np.eye(2))
E = Polytope.box(-np.array([0.3, 0.3, np.deg2rad(20)]), np.array([0.3, 0.3, np.deg2rad(20)]))
W = Polytope.box(
    -np.array([0.005, 0.005, np.deg2rad(0.2)]), np.array([0.005, 0.005, np.deg2rad(0.2)])
)
WHEELS = np.array([[1.0, TRACK / 2], [1.0, -TRACK / 2]])
U = Polytope(np.vstack([WHEELS, -WHEELS]), np.array([2.54, 2.54, 0.84, 0.84]))


def transition(right: float, left: float) -> np.ndarray:
    """Matrix A of the error model (Euler) at wheel references in m/s."""
    turn = PERIOD * GRIP / TRACK * (right - left)
    drift = PERIOD / 2 * (right + left)
    return np.array([[1.0, turn, 0.0], [-turn, 1.0, drift], [0.0, 0.0, 1.0]])


def corners(slowest: float = 0.2) -> list[tuple[float, float]]:
    return list(itertools.product((slowest, FASTEST), (slowest, FASTEST)))


@functools.cache
def regulator(slowest: float) -> np.ndarray:
    centre = (slowest + FASTEST) / 2
    return lqr_gain(transition(centre, centre), INPUT, *PAPER)


def tube_gain(right: float, left: float, slowest: float = 0.2) -> np.ndarray:
    """Gain of eqs. (22)-(25): the regulator at the centre of the box, turning compensated in the
    first row."""
    return regulator(slowest) + np.array(
        [[0.0, -GRIP / TRACK * (right - left), 0.0], [0.0, 0.0, 0.0]]
    )


def tube_loop(right: float, left: float, slowest: float = 0.2) -> np.ndarray:
    return transition(right, left) + INPUT @ tube_gain(right, left, slowest)


def tube_loops(slowest: float = 0.2) -> np.ndarray:
    return np.array([tube_loop(*corner, slowest) for corner in corners(slowest)])


def tube_gains(slowest: float = 0.2) -> np.ndarray:
    return np.array([tube_gain(*corner, slowest) for corner in corners(slowest)])


@functools.cache
def terminal_gains(slowest: float, lateral: bool, objective: Objective) -> np.ndarray:
    transitions = np.array([transition(*corner) for corner in corners(slowest)])
    weights = LATERAL if lateral else PAPER
    return terminal_cost(transitions, np.array([INPUT] * 4), *weights, objective).gains


@functools.cache
def terminal_problem(
    slowest: float, lateral: bool, objective: Objective
) -> tuple[np.ndarray, Polytope]:
    """Loops under the gains of the matrix inequality, and the errors whose inputs they keep
    admissible."""
    gains = terminal_gains(slowest, lateral, objective)
    loops = np.array(
        [
            transition(*corner) + INPUT @ gain
            for corner, gain in zip(corners(slowest), gains, strict=True)
        ]
    )
    rows = [E.normals, *(U.normals @ gain for gain in gains)]
    offsets = [E.offsets, *([U.offsets] * 4)]
    return loops, Polytope(np.concatenate(rows), np.concatenate(offsets))
