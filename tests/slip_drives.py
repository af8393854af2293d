"""Drives of slipping robots in the world frame, by complex numbers: an oracle of what observers of
slips are told."""

from typing import NamedTuple

import numpy as np

DT = 0.1
TRACK = 0.5
NOISE = np.array([1e-3, 1e-3, np.deg2rad(0.02)])
CHANGE = 0.005
LEAST = np.array([0.0, -0.05])
GREATEST = np.array([0.3, 0.25])


class Drive(NamedTuple):
    """Arrays (periods, robots, ..): true slips and wheel speeds of every period, those of the
    reference (periods, 2), and measured errors, at one instant more."""

    slips: np.ndarray
    wheels: np.ndarray
    reference: np.ndarray
    measured: np.ndarray


def draw_slips(random, periods, robots, change=CHANGE):
    """Return slips that go from one extreme or value to another as fast as they may."""
    slips = np.empty((periods, robots, 2))
    slips[0] = random.uniform(LEAST, GREATEST, (robots, 2))
    target = slips[0]
    for k in range(1, periods):
        anew = random.random((robots, 2)) < 0.1
        ends = np.where(random.random((robots, 2)) < 0.5, LEAST, GREATEST)
        inside = random.uniform(LEAST, GREATEST, (robots, 2))
        drawn = np.where(random.random((robots, 2)) < 0.5, ends, inside)
        target = np.where(anew, drawn, target)
        slips[k] = slips[k - 1] + np.clip(target - slips[k - 1], -change, change)
    return slips


def draw_noise(random, instants, robots):
    """Return noise at corners of its box."""
    return NOISE * np.where(random.random((instants, robots, 3)) < 0.5, -1.0, 1.0)


def drive(slips, wheels, reference, start, noise):
    """Return a drive of robots whose true errors begin at `start`, (robots, 3)."""
    place = -(start[:, 0] + 1j * start[:, 1]) * np.exp(-1j * start[:, 2])
    heading = -start[:, 2]
    target = 0.0
    target_heading = 0.0
    measured = [start + noise[0]]
    for k in range(len(slips)):
        place, heading = step(place, heading, wheels[k] * (1 - slips[k]))
        target, target_heading = step(target, target_heading, reference[k])
        off = (target - place) * np.exp(-1j * heading)
        errors = np.stack([off.real, off.imag, target_heading - heading], axis=1)
        measured.append(errors + noise[k + 1])
    return Drive(slips, wheels, reference, np.array(measured))


def step(place, heading, ground):
    """Return the pose after a period along an arc."""
    turn = DT * (ground[..., 0] - ground[..., 1]) / TRACK
    way = DT * (ground[..., 0] + ground[..., 1]) / 2
    chord = way * np.sinc(turn / 2 / np.pi)
    return place + chord * np.exp(1j * (heading + turn / 2)), heading + turn


def draw_drive(random, periods, robots, spread=0.3):
    """Return a drive near a reference that turns either way."""
    reference = np.repeat(random.uniform(1.2, 1.5, (-(-periods // 5), 2)), 5, axis=0)[:periods]
    slips = draw_slips(random, periods, robots)
    wheels = reference[:, None] / (1 - slips)
    wheels = wheels + random.uniform(-spread, spread, (periods, robots, 2))
    start = random.uniform(-1, 1, (robots, 3)) * [0.1, 0.15, 0.2]
    return drive(slips, wheels, reference, start, draw_noise(random, periods + 1, robots))
