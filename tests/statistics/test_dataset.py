"""The dataset of a Monte Carlo run: its statistics bit by bit, under names, places and units; and
its NetCDF file."""

import sys
from typing import ClassVar

import numpy as np
import pytest

import jaxtube as jt
from jaxtube.experiments.montecarlo import netcdf
from jaxtube.scenario import ScenarioError, to_toml
from jaxtube.statistics import histogram
from jaxtube.statistics.dataset import find_unit, make_coordinates
from jaxtube.statistics.events import EVENT_NAMES, find_row
from jaxtube.statistics.run import RANKED
from jaxtube.statistics.summary import SamplingLaw
from jaxtube.statistics.tally import CLOUD_CELLS, COVERAGE_CELLS, HEAT_CELLS, STAGE_EVENTS
from jaxtube.statistics.task import MAP_MARGIN_M

PLANS = 2


@pytest.fixture(scope="module")
def design(uncertified):
    return uncertified("certified", "reference.duration_s=1")


def count_facets(polytope):
    return len(polytope.offsets)


@pytest.fixture(scope="module")
def statistics(design):
    """Invented statistics of a design, no two numbers alike."""
    generator = np.random.default_rng(8)
    problem = design.problem
    steps = problem.reference.steps
    horizon = problem.horizon
    shapes = {
        "events": (len(EVENT_NAMES), steps + 1),
        "stage_events": (horizon, len(STAGE_EVENTS), PLANS + 1),
        "plans_by_lap": (PLANS + 1,),
        "error_by_step": (steps, 3, histogram.BUCKETS),
        **{name: (3, histogram.BUCKETS) for name in ("disturbance", "peak", "rms")},
        "map": HEAT_CELLS,
        "cloud": (horizon, 3, CLOUD_CELLS, CLOUD_CELLS),
        **{name: (3, COVERAGE_CELLS, COVERAGE_CELLS) for name in ("starts", "starts_that_left")},
        **{name: () for name in ("plans", "next_plan_missing", "cost_excesses", "laps")},
        "tube_outside/paper": (horizon,),
        **{f"worst_lap/{name}": (i,) for i, name in enumerate(RANKED)},
    }
    extremes = {
        "excess/disturbance": (count_facets(problem.disturbance_set),),
        "excess/error": (count_facets(problem.error_set),),
        "excess/input": (count_facets(problem.input_rows),),
        "tube_excess/paper": (horizon,),
        "cost_excess": (),
        "ultimate_bound": (3,),
        **{f"worst_usage/{name}": (i,) for i, name in enumerate(RANKED)},
    }
    counts = {
        name: np.asarray(generator.integers(0, 2**60, shape)) for name, shape in shapes.items()
    }
    invented = counts | {
        name: np.asarray(generator.normal(size=shape)) for name, shape in extremes.items()
    }
    invented["tube_excess/paper"][0] = -np.inf
    return invented


class Invented(jt.MonteCarlo):
    """A run whose statistics are too wild for a summary."""

    summary: ClassVar = {"law": "invented"}


@pytest.fixture
def run(design, statistics):
    return Invented(design, SamplingLaw("tube_mpc", "robot", "scenario", "iid"), 3, statistics)


def check_dataset(dataset, run):
    statistics = run.statistics
    assert set(dataset.data_vars) == {name.replace("/", "_") for name in statistics}
    for name, value in statistics.items():
        back = dataset[name.replace("/", "_")]
        assert back.dtype == value.dtype
        assert np.array_equal(back.values, value)
    outside = dataset["events"].sel(event="e_outside_E")
    assert np.array_equal(outside, statistics["events"][find_row("e_outside_E")])
    steps = run.design.problem.reference.steps
    heading = dataset["error_by_step"].sel(coordinate="heading", step=steps)
    assert np.array_equal(heading, statistics["error_by_step"][-1, 2])
    assert heading.bucket.values[9] == histogram.EDGES[9]
    assert heading.bucket_upper.values[9] == histogram.EDGES[10]
    cloud = dataset["cloud"].sel(stage=2, plane="lateral,heading")
    assert np.array_equal(cloud, statistics["cloud"][1, 2])
    assert dataset["tube_outside_paper"].dims == ("stage",)
    check_attributes(dataset)
    assert dataset.attrs == {
        "source": "jaxtube montecarlo",
        "controller": "tube_mpc",
        "plant": "robot",
        "starts": "scenario",
        "title": f"statistics of {int(statistics['laps']):,} laps",
        "law": "invented",
        "seed": 3,
        "scenario": to_toml(run.design.problem.scenario),
    }


def check_attributes(dataset):
    """Everything has a name in words; every number has a unit, or names the coordinate along one of
    its dimensions that holds its units."""
    for name, variable in dataset.variables.items():
        assert variable.attrs["long_name"], name
        if not np.issubdtype(variable.dtype, np.number):
            continue
        assert ("units" in variable.attrs) != ("units_from" in variable.attrs), name
        if "units_from" in variable.attrs:
            units = dataset[variable.attrs["units_from"]]
            of_coordinate = {"bucket", "bucket_upper"}
            assert name in of_coordinate or set(units.dims) <= set(variable.dims), name
            assert set(units.values) <= {"m", "rad", "m/s", "rad/s", "m and rad"}
    seconds = dataset["time"]
    assert seconds.attrs["units"] == "s"
    assert seconds.values[0] == pytest.approx(seconds.values[-1] / dataset.sizes["step"])


def test_statistics_come_back_bit_by_bit_under_named_coordinates(run):
    pytest.importorskip("xarray")
    check_dataset(run.to_xarray(), run)


def test_the_file_holds_the_dataset(run, tmp_path):
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("h5netcdf")
    pytest.importorskip("h5py")
    netcdf.save(tmp_path / "statistics.nc", run)
    assert [path.name for path in tmp_path.iterdir()] == ["statistics.nc"]
    with xarray.open_dataset(tmp_path / "statistics.nc") as dataset:
        check_dataset(dataset, run)
        assert dataset.identical(run.to_xarray())


def test_cells_have_places_and_coordinates_have_units(design, statistics):
    coordinates = make_coordinates(design, statistics)
    for name, (dimensions, values, *_) in coordinates.items():
        assert np.ndim(values) == (1 if isinstance(dimensions, str) else len(dimensions)), name
    problem = design.problem
    x = coordinates["map_column"][1]
    y = coordinates["map_row"][1]
    cell = x[1] - x[0]
    assert (len(y), len(x)) == HEAT_CELLS
    np.testing.assert_allclose(np.diff(x), cell)
    np.testing.assert_allclose(np.diff(y), cell)
    corner = problem.reference.poses[: problem.reference.steps + 1, :2].min(axis=0) - MAP_MARGIN_M
    np.testing.assert_allclose([x[0], y[0]], corner + cell / 2)
    assert coordinates["unit"][1].tolist() == ["m", "m", "rad"]
    assert coordinates["error_facet_unit"][1].tolist() == ["m", "m", "rad"] * 2
    of_caps = ["m/s", "rad/s", "rad/s", "rad/s"]
    assert coordinates["input_facet_unit"][1].tolist() == of_caps * 2
    edge = 2 - 2 / CLOUD_CELLS
    assert coordinates["cloud_row"][1][[0, -1]] == pytest.approx([-edge, edge])
    widths = [section.polytope().support(np.eye(3)) for section in design.tube[1:]]
    np.testing.assert_allclose(coordinates["section_half_width"][1], widths)
    assert coordinates["start_column"][1][-1] == pytest.approx(1 - 1 / COVERAGE_CELLS)


@pytest.mark.parametrize(
    ("normal", "unit"),
    [((0, 1, 0), "m"), ((0.6, -0.8, 0), "m"), ((0, 0, 1), "rad"), ((0, 0.6, 0.8), "m and rad")],
)
def test_the_excess_over_a_slanted_facet_mixes_units(normal, unit):
    assert find_unit(np.array(normal)) == unit


def test_without_xarray_a_dataset_is_refused_with_the_cure(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(ImportError, match=r"pip install 'jaxtube\[results\]'"):
        run.to_xarray()


@pytest.mark.parametrize("missing", ["xarray", "h5netcdf", "h5py"])
def test_a_library_that_the_file_misses_is_named_with_its_cure(run, tmp_path, monkeypatch, missing):
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(ScenarioError, match=r"is not installed; pip install 'jaxtube\[results\]'"):
        netcdf.save(tmp_path / "statistics.nc", run)
    assert not any(tmp_path.iterdir())
