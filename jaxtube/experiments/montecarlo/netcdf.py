"""The statistics of a Monte Carlo run as NetCDF: named dimensions and coordinates, which xarray and
others open.

The slash of a name, such as `excess/error`, becomes an underscore. Lengths are in m, angles in rad.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from jaxtube.experiments.run.atomic import write_atomically
from jaxtube.scenario.refusal import refusal
from jaxtube.statistics import histogram
from jaxtube.statistics.run import RANKED, Statistics
from jaxtube.statistics.tally import EVENTS, PLANES, STAGE_EVENTS

NAMES = ("longitudinal", "lateral", "heading")
DIMENSIONS = {
    "events": ("event", "steps_with_event"),
    "stage_events": ("stage", "stage_event", "plans_with_event"),
    "plans_by_lap": ("plans_with_event",),
    "ultimate_bound": ("coordinate",),
    "error_by_step": ("step", "coordinate", "bucket"),
    **{name: ("coordinate", "bucket") for name in ("disturbance", "peak", "rms")},
    "map": ("map_row", "map_column"),
    "cloud": ("stage", "plane", "cloud_row", "cloud_column"),
    **{name: ("plane", "start_row", "start_column") for name in ("starts", "starts_that_left")},
    **{f"excess/{name}": (f"{name}_facet",) for name in ("disturbance", "error", "input")},
    **{
        f"{key}/{name}": (f"rank_{name}",)
        for key in ("worst_lap", "worst_usage")
        for name in RANKED
    },
}
"""Of each statistic; those of a tube run over its stages, the others are single numbers."""

EXPLANATIONS = {
    "events": "laps that had the event in so many of their steps",
    "stage_events": "laps that had the event in so many of their plans",
    "error_by_step": "laps with |e| in the bucket, after each period",
    "disturbance": "steps with |w| in the bucket",
    "peak": "laps whose largest |e| is in the bucket",
    "rms": "laps whose RMS error, once settled, is in the bucket",
    "map": "robots that ended a period in the cell",
    "cloud": "plans whose deviation is in the cell; cells reach to twice the box around the section",
    "starts": "laps that started in the cell; cells span E",
    "starts_that_left": "those of them that left E",
    "laps": "laps of the run",
    "plans": "plans followed to their end",
    "plans_by_lap": "laps with so many plans",
    "next_plan_missing": "plans without another one where they expected the error a step later",
    "cost_excesses": "plans whose cost fell by less than that of the step",
    "cost_excess": "largest V+ - V + cost of the step; negative: every cost fell by more",
    "ultimate_bound": "half widths that hold the settled error while w is in W and no row is active",
}


def libraries() -> Any:
    """Return xarray.

    Raises: ScenarioError where it, or what it writes NetCDF with, is not installed.
    """
    try:
        import h5netcdf  # noqa: F401
        import h5py  # noqa: F401
        import xarray
    except ImportError as error:
        problem = f"{error.name} is not installed"
        raise refusal(
            "command line", "--netcdf", True, problem, "pip install 'jaxtube[results]'"
        ) from None
    return xarray


def save(path: Path, statistics: Statistics) -> None:
    """Write statistics as NetCDF; the file appears complete or not at all.

    Raises: ScenarioError as `libraries`, OSError where the file cannot be written.
    """
    variables = {
        name.replace("/", "_"): _variable(name, value) for name, value in statistics.items()
    }
    dataset = libraries().Dataset(variables, coordinates(statistics))
    write_atomically(path, lambda file: dataset.to_netcdf(file.name, engine="h5netcdf"))


def _variable(name: str, value: Any) -> tuple:
    """Return (dimensions, values, attributes)."""
    value = np.asarray(value)
    of_stages = ("stage",) if name.startswith("tube_") else ()
    explanation = EXPLANATIONS.get(name)
    return DIMENSIONS.get(name, of_stages), value, {"long_name": explanation} if explanation else {}


def coordinates(statistics: Statistics) -> dict[str, tuple]:
    """Return the coordinates, by name: (dimension, values, attributes)."""
    lower = np.append(0.0, histogram.EDGES[1:])
    upper = np.append(histogram.EDGES[1:], np.inf)
    steps, stages = len(statistics["error_by_step"]), len(statistics["cloud"])
    plain = {
        "event": np.array(EVENTS),
        "steps_with_event": np.arange(steps + 1),
        "stage": np.arange(1, stages + 1),
        "stage_event": np.array(STAGE_EVENTS),
        "plans_with_event": np.arange(statistics["stage_events"].shape[-1]),
        "coordinate": np.array(NAMES),
        "plane": np.array([f"{NAMES[first]},{NAMES[second]}" for first, second in PLANES]),
        **{
            f"{name}_facet": np.arange(len(statistics[f"excess/{name}"]))
            for name in ("disturbance", "error", "input")
        },
    }
    return {
        **{name: (name, values) for name, values in plain.items()},
        "step": ("step", np.arange(1, steps + 1), {"long_name": "periods gone"}),
        "bucket": ("bucket", lower, {"long_name": "lower edge, m or rad"}),
        "bucket_upper": ("bucket", upper, {"long_name": "upper edge, m or rad"}),
    }
