"""Laps that no loop has driven, for tests of what plays and draws them: cheap, and known."""

import numpy as np

from jaxtube.reporting.laps import LapSet, StoredLaps, find_poses

PERIOD_S = 0.1
STEPS = 40
LIMITS = np.array([0.3, 0.2, np.deg2rad(20.0)])
SECTION = np.array([[-0.02, -0.01], [0.02, -0.01], [0.02, 0.01], [-0.02, 0.01]])


def invent_laps(count=5, names=("uncompensated", "tube_mpc"), steps=STEPS):
    """Return laps on a circle; lap l of each controller has errors that grow with l, and the last
    one of the first controller leaves E."""
    time = PERIOD_S * np.arange(steps + 1)
    angle = 0.4 * time
    reference = np.stack([3 * np.sin(angle), 3 - 3 * np.cos(angle), angle], axis=1)
    laps = {}
    for number, name in enumerate(names):
        sizes = (1.2 - 0.7 * min(number, 1)) * np.arange(1, count + 1) / count
        shape = np.stack([np.sin(time), np.cos(2 * time), np.sin(3 * time)], axis=1)
        errors = shape[:, None] * sizes[None, :, None] * LIMITS
        laps[name] = LapSet(
            errors.astype(np.float32),
            np.zeros((steps, count, 2), np.float32),
            np.full((steps, count, 2), 1.25, np.float32),
            np.arange(count) + 10,
            1000,
            LIMITS,
            SECTION,
        )
    return StoredLaps(PERIOD_S, reference, 0.5, laps)


def find_pose(stored, name, place, instant):
    """Return the pose of a robot in the world."""
    return find_poses(stored.laps[name].errors[instant, place], stored.reference_poses[instant])
