"""Whether what a certificate says of wheels that lag holds, in floats: robots from pasts that are
drawn are followed step by step, by code that neither the checker nor the bounds share."""

from itertools import product
from types import SimpleNamespace

import numpy as np
from late_robot import (
    LatePeriod,
    back,
    commit,
    drive,
    find_rest,
    follow_back,
    join,
    read_errors,
)

from sets.robot.actuation import Nominal
from sets.robot.driving import find_driving
from sets.robot.plant import Kinematics

PASTS = 25
COMMANDS = 9
"""Of a past: more than its lag and its delay last."""
ROUNDING = 1e-9
LOOSER = 0.01
"""Of speeds that are bounded, m/s."""
CORNERS = np.array(list(product((-1, 1), repeat=3)))
WHEELS = ("right", "left")


def keeps_lateness(said, band, operation, losses) -> bool:
    """Return whether no past is found that leaves what a certificate says of lag: over an operation
    whose wheels obey at once, with the ranges of d by wheel."""
    late = said["lateness"]
    nominal = Nominal(*late["nominal"])
    is_known = 0 <= late["lag"][0] <= nominal.lag <= late["lag"][1]
    is_known &= 0 <= late["delay"][0] <= nominal.delay <= late["delay"][1]
    if not (is_known and late["delay"][1] - late["delay"][0] <= said["period"]):
        return False
    driving = find_driving(operation, Kinematics())
    low, high = np.array([*(late["wheels"][wheel] for wheel in WHEELS), late["speeds"]]).T
    found = np.array([[*driving.wheels[end], driving.speed[end]] for end in (0, 1)])
    if np.any(found[0] < low - LOOSER) or np.any(found[1] > high + LOOSER):
        return False
    generator = np.random.default_rng(0)
    pasts = [_draw_past(said, band, nominal, losses, generator) for _ in range(PASTS)]
    estimate = (np.array(operation.gain), operation.estimate_error)
    return all(_stays(said, band, estimate, past) for past in pasts)


def _draw_past(said, band, nominal, losses, generator):
    late = said["lateness"]
    ends = [_list_ends(region) for region in band["regions"]]
    b = said["track"]
    reference = []
    commands = []
    for _ in range(COMMANDS):
        low, high = ends[generator.integers(len(ends))]
        wheels = np.where(generator.random(2) < 0.5, low, high)
        turning = (wheels[0] - wheels[1]) / 2 - generator.choice(band["u2"]) * b / 2
        speed = generator.choice(late["speeds"])
        reference.append(wheels)
        asked = [speed + turning, speed - turning]
        commands.append(np.clip(asked, *np.array([late["wheels"][wheel] for wheel in WHEELS]).T))
    period = LatePeriod(
        said["period"],
        b,
        nominal,
        np.array(commands),
        float(generator.choice(late["lag"])),
        generator.choice(late["delay"], COMMANDS),
        np.array([generator.choice(wheel) for wheel in losses]),
        said["sideslip"] * generator.choice((-1, 1)),
    )
    return SimpleNamespace(period=period, reference=np.array(reference))


def _list_ends(region):
    return (region, region) if len(region) == 2 else ((region[0],) * 2, (region[1],) * 2)


def _stays(said, band, estimate, past) -> bool:
    period = past.period
    noise = np.array(said["noise"])
    W = band["disturbance"]
    gain, error = estimate
    rest, _, kick = find_rest(period, said["lateness"]["lever"])
    unpredicted = np.abs([*rest, abs(kick) + error[2]])
    if gain[2] * abs(kick) > W["yaw"] + ROUNDING:
        return False
    reached = gain * (unpredicted + noise)
    following = (1 - gain) * unpredicted + gain * noise
    if np.any(reached[:2] - W["box"][:2] > ROUNDING) or np.any(following - error > ROUNDING):
        return False
    latency = sum(period.nominal)
    ahead = commit(period, now=True)[:2]
    behind = follow_back(period, past.reference, latency)
    driven = drive(period, latency)
    limits = np.array(said["constraints"]) + ROUNDING
    for corner in CORNERS:
        x, y, heading = corner * (np.array(band["errors"]) + error)
        reference = join(ahead, (x + 1j * y, heading))
        now = read_errors(join(reference, back(behind)))
        later = read_errors(join(back(driven), reference))
        if np.any(np.abs(now) > limits) or np.any(np.abs(later) > limits):
            return False
        x, y, heading = corner * np.array(said["lateness"]["noise"])
        measured = read_errors(join(join(back(ahead), (x + 1j * y, heading)), behind))
        exact = read_errors(join(back(ahead), behind))
        if np.any(np.abs(measured - exact) > noise + ROUNDING):
            return False
    return True
