"""The statistics of a Monte Carlo run as an xarray Dataset: named dimensions, coordinates, units.

The slash of a name, such as `excess/error`, becomes an underscore. Lengths are in m, angles in rad.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxtube.coordinates import NAMES, PLANES, SI_UNITS
from jaxtube.simulation.dataset import import_xarray
from jaxtube.statistics import histogram
from jaxtube.statistics.events import EVENT_NAMES
from jaxtube.statistics.run import RANKED, Statistics
from jaxtube.statistics.tally import CLOUD_REACH, STAGE_EVENTS
from jaxtube.statistics.task import (
    disturbance_facets,
    facets,
    input_facets_of,
    lay_map_grid,
    sections,
)
from jaxtube.synthesis.parts import Design

RANKED_SETS = {"error": "E", "disturbance": "W", "tube": "the tube"}
"""By what laps are ranked: the set whose use ranks them."""

DIMENSIONS = {
    "events": ("event", "steps_with_event"),
    "stage_events": ("stage", "stage_event", "plans_with_event"),
    "plans_by_lap": ("plans_with_event",),
    "ultimate_bound": ("coordinate",),
    "command_step": ("wheel",),
    "slip_radius": ("wheel",),
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
    "cloud": "plans whose deviation is in the cell; cells reach to twice the section's box",
    "starts": "laps that started in the cell; cells span E",
    "starts_that_left": "those of them that left E",
    "laps": "laps of the run",
    "plans": "plans followed to their end",
    "plans_by_lap": "laps with so many plans",
    "next_plan_missing": "plans without another one where they expected the error a step later",
    "cost_excesses": "plans whose cost fell by less than that of the step",
    "cost_excess": "largest V+ - V + cost of the step; negative: every cost fell by more",
    "command_step": "largest change of each wheel's command in a period, m/s",
    "slip_radius": "half of the widest interval of each wheel's slip, once it is learnt",
    "ultimate_bound": "half widths of the settled error while w is in W and no row is active",
    **{
        f"excess/{name}": f"largest excess over each facet of {of_set}; negative: inside"
        for name, of_set in {"disturbance": "W", "error": "E", "input": "U"}.items()
    },
    **{
        f"worst_lap/{name}": f"numbers of the laps that used most of {of_set}"
        for name, of_set in RANKED_SETS.items()
    },
    **{
        f"worst_usage/{name}": f"what they used of {of_set}, 1 being its boundary"
        for name, of_set in RANKED_SETS.items()
    },
}

OF_TUBES = {
    "tube_outside": "plans outside the section of each stage of the tube",
    "tube_excess": "largest excess over a facet of each stage of the tube",
}
"""What the statistics of a tube are; its name follows."""

BY_COORDINATE = {"units_from": "unit"}
"""Attribute of what is in the unit of the coordinate."""


def make_dataset(
    design: Design, statistics: Statistics, attributes: Mapping[str, str | int]
) -> Any:
    """Return statistics as an xarray Dataset.

    Args:
        design: that the run was checked against; it gives the grids and the facets.
        statistics: of the run.
        attributes: of the whole, such as scenario, seed and law.

    Raises:
        ImportError: where xarray is not installed; the message says how to.
    """
    variables = {
        name.replace("/", "_"): _make_variable(name, value) for name, value in statistics.items()
    }
    coordinates = make_coordinates(design, statistics)
    return import_xarray().Dataset(variables, coordinates, dict(attributes))


class Variable(NamedTuple):
    """What xarray makes a variable of."""

    dimensions: tuple[str, ...]
    values: np.ndarray
    attributes: dict[str, str]


def _make_variable(name: str, value: Any) -> Variable:
    of_stages = ("stage",) if name.startswith("tube_") else ()
    attributes = {"long_name": _explain(name)} | find_units(name)
    return Variable(DIMENSIONS.get(name, of_stages), np.asarray(value), attributes)


def _explain(name: str) -> str:
    """Return what a statistic is, in words."""
    if name in EXPLANATIONS:
        return EXPLANATIONS[name]
    kind, tube = name.split("/")
    return f"{OF_TUBES[kind]} {tube!r}"


def find_units(name: str) -> dict[str, str]:
    """Return the attribute that tells the unit of a statistic: `units`, or, where it changes along
    a dimension, `units_from`, the coordinate that holds the units."""
    kind, _, of_set = name.partition("/")
    if kind == "excess":
        return {"units_from": f"{of_set}_facet_unit"}
    if name == "ultimate_bound":
        return {"units_from": "unit"}
    if kind == "tube_excess":
        return {"units": "m or rad"}
    return {"units": "m/s" if name == "command_step" else "1"}


def make_coordinates(design: Design, statistics: Statistics) -> dict[str, tuple]:
    """Return the coordinates, by name: (dimensions, values, attributes)."""
    steps = len(statistics["error_by_step"])
    stages = len(statistics["cloud"])
    plans = statistics["stage_events"].shape[-1]
    planes = [f"{NAMES[first]},{NAMES[second]}" for first, second in PLANES]
    plain = {
        "event": (np.array(EVENT_NAMES), "event of a period"),
        "steps_with_event": (np.arange(steps + 1), "steps of a lap that had the event"),
        "stage": (np.arange(1, stages + 1), "stage of a plan"),
        "stage_event": (np.array(STAGE_EVENTS), "event of a plan at a stage"),
        "plans_with_event": (np.arange(plans), "plans of a lap that had the event"),
        "coordinate": (np.array(NAMES), "coordinate of errors and disturbances"),
        "plane": (np.array(planes), "pair of coordinates, abscissa first"),
        "step": (np.arange(1, steps + 1), "periods gone"),
    }
    if "command_step" in statistics or "slip_radius" in statistics:
        plain["wheel"] = (np.array(["right", "left"]), "wheel")
    for name in ("disturbance", "error", "input"):
        facet = np.arange(len(statistics[f"excess/{name}"]))
        plain[f"{name}_facet"] = (facet, f"facet of the {name} set")
    time = design.problem.reference.dt * np.arange(1, steps + 1)
    return {
        **{name: _make_coordinate(name, *content) for name, content in plain.items()},
        "unit": ("coordinate", np.array(SI_UNITS), {"long_name": "unit of the coordinate"}),
        "time": ("step", time, {"long_name": "time since the start", "units": "s"}),
        **_buckets(),
        **_facet_units(design),
        **_map_cells(design, statistics),
        **_cloud_cells(design, statistics),
        **_start_cells(design, statistics),
    }


def _make_coordinate(name: str, values: np.ndarray, long_name: str) -> tuple:
    """Return a coordinate along its own dimension; numbers without a unit have the unit 1."""
    unit = {"units": "1"} if np.issubdtype(values.dtype, np.number) else {}
    return name, values, {"long_name": long_name} | unit


def _buckets() -> dict[str, tuple]:
    lower = np.append(0.0, histogram.EDGES[1:])
    upper = np.append(histogram.EDGES[1:], np.inf)
    of_unit = "in the unit of the coordinate"
    return {
        "bucket": ("bucket", lower, {"long_name": f"lower edge, {of_unit}", **BY_COORDINATE}),
        "bucket_upper": ("bucket", upper, {"long_name": f"upper edge, {of_unit}", **BY_COORDINATE}),
    }


def _facet_units(design: Design) -> dict[str, tuple]:
    """Return the unit in which the excess over each facet is given."""
    problem = design.problem
    units = {
        "disturbance": list(map(find_unit, disturbance_facets(problem).normals)),
        "error": list(map(find_unit, facets(problem.error_set).normals)),
        "input": list(map(find_input_unit, input_facets_of(problem).normals[:, :2])),
    }
    return {
        f"{name}_facet_unit": (
            f"{name}_facet",
            np.array(values),
            {"long_name": f"unit along the facet of the {name} set"},
        )
        for name, values in units.items()
    }


def find_unit(normal: Float[np.ndarray, "3"]) -> str:
    """Return the unit along a facet's normal; a slanted one mixes both."""
    along = np.abs(normal) > 1e-9 * np.max(np.abs(normal))
    if along[2]:
        return "m and rad" if along[:2].any() else "rad"
    return "m"


def find_input_unit(row: Float[np.ndarray, "2"]) -> str:
    """Return the unit of a row on the virtual input: wheels and speed in m/s, yaw rate in rad/s."""
    return "m/s" if row[0] else "rad/s"


def _map_cells(design: Design, statistics: Statistics) -> dict[str, tuple]:
    """Return the centres of the cells of the map, in the world's frame."""
    rows, columns = statistics["map"].shape
    corner, cell = lay_map_grid(design.problem.reference)
    x = corner[0] + cell * (np.arange(columns) + 0.5)
    y = corner[1] + cell * (np.arange(rows) + 0.5)
    return {
        "map_column": ("map_column", x, {"long_name": "x of the cell's centre", "units": "m"}),
        "map_row": ("map_row", y, {"long_name": "y of the cell's centre", "units": "m"}),
    }


def _cloud_cells(design: Design, statistics: Statistics) -> dict[str, tuple]:
    """Return the centres of the cells of the clouds, and the boxes they are multiples of."""
    by_window = sections(design, design.problem.scenario.controller.tube).facets
    half_widths = np.maximum(by_window.upper, -by_window.lower).max(axis=0)
    rows, columns = statistics["cloud"].shape[-2:]
    unit = "half widths of the box around the section"
    box = f"{unit}, the largest along the reference"
    return {
        **_centre("cloud_column", CLOUD_REACH * _centres(columns), unit, "first"),
        **_centre("cloud_row", CLOUD_REACH * _centres(rows), unit, "second"),
        "section_half_width": (
            ("stage", "coordinate"),
            half_widths,
            {"long_name": box, **BY_COORDINATE},
        ),
    }


def _start_cells(design: Design, statistics: Statistics) -> dict[str, tuple]:
    """Return the centres of the cells of the starts, and the limits they are multiples of."""
    rows, columns = statistics["starts"].shape[-2:]
    limits = facets(design.problem.error_set).upper
    return {
        **_centre("start_column", _centres(columns), "limits of E", "first"),
        **_centre("start_row", _centres(rows), "limits of E", "second"),
        "error_limit": ("coordinate", limits, {"long_name": "half widths of E", **BY_COORDINATE}),
    }


def _centre(name: str, values: Float[np.ndarray, " cells"], unit: str, which: str) -> dict:
    """Return the coordinate of the centres of cells along an axis of a plane."""
    explanation = f"centre of the cell, in {unit}, {which} coordinate of the plane"
    return {name: (name, values, {"long_name": explanation, "units": "1"})}


def _centres(cells: int) -> Float[np.ndarray, " cells"]:
    """Return the centres of equal cells from -1 to 1."""
    return (2 * np.arange(cells) + 1) / cells - 1
