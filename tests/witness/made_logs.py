"""Logs of the project's own simulator, and scenarios beside them."""

from jaxtube.identification.findings import inspect_log
from jaxtube.identification.simulated.drive import Truth, drive
from jaxtube.identification.simulated.log import Sensors, record
from jaxtube.scenario.tree import to_toml
from jaxtube.scenario.validation import validate

TRUTH = Truth(slip=((0.02, 0.3), (0.02, 0.1)), effective_track=0.7, lever_arm=0.05)
SENSORS = Sensors(wheel_noise=0.0, pose_noise=0.001, heading_noise=0.0005)
FITS = {
    "robot": {
        "effective_track_m": 0.7,
        "lever_arm_m": 0.05,
        "wheel_speed_min_mps": 0.2,
        "wheel_speed_max_mps": 1.05,
    },
    "reference": {
        "speed_mps": 0.5,
        "wheel_speed_min_mps": 0.4,
        "wheel_speed_max_mps": 0.6,
    },
    "slip": {"right": [0.015, 0.305], "left": [0.015, 0.105], "sideslip": 0.032},
    "noise": {
        "frame": "world",
        "longitudinal_m": 0.005,
        "lateral_m": 0.005,
        "heading_deg": 0.15,
    },
    "operating": {"longitudinal_m": 0.1, "lateral_m": 0.1, "heading_deg": 10.0},
    "disturbance": {"bound": "computed"},
    "controller": {
        "model": "exact_jacobian",
        "input_map": "x_exact",
        "tube": "sequence",
        "terminal": "T-A",
    },
}
"""A scenario that allows all of TRUTH, with noise of five standard deviations."""


def make_log(commands=14, seed=3, sensors=SENSORS, truth=TRUTH):
    """A simulated log and what lies behind it."""
    return record(drive(truth, commands, seed), sensors, seed)


def find(simulated):
    return inspect_log(simulated.log, 2.0)


def scenario(**more):
    """The scenario that fits, with other keys: slip={"right": [0.0, 0.1]}."""
    tables = {name: {**table, **more.get(name, {})} for name, table in FITS.items()}
    return validate(tables, lambda key: "made")


def write_scenario(path, comment="", **more):
    """Write the same scenario as a file."""
    text = "\n".join(f"# {line}" for line in comment.splitlines())
    path.write_text(f"{text}\n{to_toml(scenario(**more))}")
    return path
