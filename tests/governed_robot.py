"""A robot that slips, under a governor, in the world: slips and noise as far off as is allowed."""

from __future__ import annotations

import numpy as np

from jaxtube.plant.reference import drive


class Robot:
    """A robot of a design at a pose of its own."""

    def __init__(self, design, pose, seed):
        self.pose = np.asarray(pose, float)
        self._problem = design.problem
        self._generator = np.random.default_rng(seed)

    def measure(self):
        """The pose with noise at the corners of its box, which lies along the robot's axes."""
        noise = self._problem.noise * self._generator.choice([-1.0, 1.0], 3)
        place = (noise[0] + 1j * noise[1]) * np.exp(1j * self.pose[2])
        return self.pose + np.array([place.real, place.imag, noise[2]])

    def move(self, wheels):
        """One period, the true slips at a corner of what is allowed."""
        slip = self._problem.scenario.slip
        off = 1.0 + slip.relative_error * self._generator.choice([-1.0, 1.0], 2)
        ground = wheels * (1.0 - np.array(slip.nominal) * off)
        dt = self._problem.reference.dt
        self.pose = drive(self.pose, ground, dt, self._problem.robot.track_width)

    def run(self, governor, periods, wish=None, kicks=None):
        """The steps of so many periods, or up to the end of the path; `kicks` move the robot before
        a period."""
        steps = []
        for period in range(periods):
            if governor.has_ended:
                break
            self.pose = self.pose + (kicks or {}).get(period, 0.0)
            steps.append(governor(self.measure(), None if wish is None else wish(period)))
            self.move(steps[-1].wheels)
        return steps


def find_start(error, reference_pose):
    """The pose of a robot that has a tracking error (m, m, rad)."""
    heading = reference_pose[2] - error[2]
    place = (error[0] + 1j * error[1]) * np.exp(1j * heading)
    return np.array([reference_pose[0] - place.real, reference_pose[1] - place.imag, heading])
