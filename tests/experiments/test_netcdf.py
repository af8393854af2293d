"""Statistics come back from NetCDF as they were, under names; a missing library costs one line."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from jaxtube.experiments.montecarlo import netcdf
from jaxtube.scenario import ScenarioError
from jaxtube.statistics import histogram
from jaxtube.statistics.checks import Facets, Sections
from jaxtube.statistics.events import EVENT_NAMES, find_row
from jaxtube.statistics.run import RANKED
from jaxtube.statistics.tally import CLOUD_CELLS, COVERAGE_CELLS, HEAT_CELLS, STAGE_EVENTS

STEPS = 6
HORIZON = 4
PLANS = 2


@pytest.fixture
def statistics():
    """Invented statistics, no two numbers alike."""
    generator = np.random.default_rng(8)
    shapes = {
        "events": (len(EVENT_NAMES), STEPS + 1),
        "stage_events": (HORIZON, len(STAGE_EVENTS), PLANS + 1),
        "plans_by_lap": (PLANS + 1,),
        "error_by_step": (STEPS, 3, histogram.BUCKETS),
        **{name: (3, histogram.BUCKETS) for name in ("disturbance", "peak", "rms")},
        "map": HEAT_CELLS,
        "cloud": (HORIZON, 3, CLOUD_CELLS, CLOUD_CELLS),
        **{name: (3, COVERAGE_CELLS, COVERAGE_CELLS) for name in ("starts", "starts_that_left")},
        **{name: () for name in ("plans", "next_plan_missing", "cost_excesses", "laps")},
        "tube_outside/paper": (HORIZON,),
        **{f"worst_lap/{name}": (i,) for i, name in enumerate(RANKED)},
    }
    extremes = {
        "excess/disturbance": (6,),
        "excess/error": (6,),
        "excess/input": (4,),
        "tube_excess/paper": (HORIZON,),
    }
    extremes |= {
        "cost_excess": (),
        "ultimate_bound": (3,),
        **{f"worst_usage/{name}": (i,) for i, name in enumerate(RANKED)},
    }
    counts = {
        name: np.asarray(generator.integers(0, 2**60, shape)) for name, shape in shapes.items()
    }
    found = counts | {
        name: np.asarray(generator.normal(size=shape)) for name, shape in extremes.items()
    }
    found["tube_excess/paper"][0] = -np.inf
    return found


@pytest.fixture
def checks():
    """The sets and grids of an invented run; the first facet of W is slanted."""
    normals = np.concatenate([np.eye(3), -np.eye(3)])
    limits = np.array([0.3, 0.25, 0.5])
    box = Facets(normals, np.tile(limits, 2), -limits, limits)
    slanted = np.concatenate([[[0.0, 0.6, 0.8]], normals[1:]])
    widths = np.arange(1, HORIZON + 1)[:, None] * [0.1, 0.2, 0.3]
    sections = Facets(None, None, -widths[None], widths[None])
    return SimpleNamespace(
        map_corner=np.array([-1.0, 2.0]),
        map_cell=0.5,
        error=box,
        disturbance=box._replace(normals=slanted),
        input=Facets(np.eye(2), np.ones(4), None, None),
        tube="paper",
        tubes={"paper": Sections(sections, np.zeros(STEPS, int))},
    )


def test_statistics_come_back_bit_by_bit_under_named_coordinates(statistics, checks, tmp_path):
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("h5netcdf")
    pytest.importorskip("h5py")
    attributes = {"scenario": "[robot]\n", "seed": 3, "law": "invented"}
    netcdf.save(tmp_path / "statistics.nc", statistics, checks, attributes)
    assert [path.name for path in tmp_path.iterdir()] == ["statistics.nc"]
    with xarray.open_dataset(tmp_path / "statistics.nc") as dataset:
        assert set(dataset.data_vars) == {name.replace("/", "_") for name in statistics}
        for name, value in statistics.items():
            back = dataset[name.replace("/", "_")]
            assert back.dtype == value.dtype
            assert np.array_equal(back.values, value)
        outside = dataset["events"].sel(event="e_outside_E")
        assert np.array_equal(outside, statistics["events"][find_row("e_outside_E")])
        later = dataset["error_by_step"]
        heading = later.sel(coordinate="heading", step=STEPS)
        assert np.array_equal(heading, statistics["error_by_step"][-1, 2])
        assert heading.bucket.values[9] == histogram.EDGES[9]
        assert heading.bucket_upper.values[9] == histogram.EDGES[10]
        cloud = dataset["cloud"].sel(stage=2, plane="lateral,heading")
        assert np.array_equal(cloud, statistics["cloud"][1, 2])
        assert dataset["tube_outside_paper"].dims == ("stage",)
        assert dataset.attrs == attributes


def test_cells_have_places_and_coordinates_have_units(statistics, checks):
    found = netcdf.coordinates(statistics, checks)
    for name, (dimensions, values, *_) in found.items():
        assert np.ndim(values) == (1 if isinstance(dimensions, str) else len(dimensions)), name
    rows, columns = HEAT_CELLS
    np.testing.assert_allclose(found["map_column"][1], -1 + 0.5 * (np.arange(columns) + 0.5))
    np.testing.assert_allclose(found["map_row"][1], 2 + 0.5 * (np.arange(rows) + 0.5))
    assert found["unit"][1].tolist() == ["m", "m", "rad"]
    assert found["error_facet_unit"][1].tolist() == ["m", "m", "rad"] * 2
    edge = 2 - 2 / CLOUD_CELLS
    assert found["cloud_row"][1][[0, -1]] == pytest.approx([-edge, edge])
    np.testing.assert_array_equal(found["section_half_width"][1][:, 1], 0.2 * np.arange(1, 5))
    assert found["start_column"][1][-1] == pytest.approx(1 - 1 / COVERAGE_CELLS)


@pytest.mark.parametrize("missing", ["xarray", "h5netcdf", "h5py"])
def test_a_missing_library_is_named_with_its_cure(
    statistics, checks, tmp_path, monkeypatch, missing
):
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(ScenarioError, match=r"is not installed; pip install 'jaxtube\[results\]'"):
        netcdf.save(tmp_path / "statistics.nc", statistics, checks, {})
    assert not any(tmp_path.iterdir())
