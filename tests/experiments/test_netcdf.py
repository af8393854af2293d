"""Statistics come back from NetCDF as they were, under names, and a missing library costs one line."""

import sys

import numpy as np
import pytest

from jaxtube.experiments.montecarlo import netcdf
from jaxtube.scenario import ScenarioError
from jaxtube.statistics import histogram
from jaxtube.statistics.run import RANKED
from jaxtube.statistics.tally import CLOUD_CELLS, COVERAGE_CELLS, EVENTS, HEAT_CELLS, STAGE_EVENTS

STEPS, HORIZON, PLANS = 6, 4, 2


@pytest.fixture
def statistics():
    """Invented statistics, no two numbers alike."""
    generator = np.random.default_rng(8)
    shapes = {
        "events": (len(EVENTS), STEPS + 1),
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


def test_statistics_come_back_bit_by_bit_under_named_coordinates(statistics, tmp_path):
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("h5netcdf")
    pytest.importorskip("h5py")
    netcdf.save(tmp_path / "statistics.nc", statistics)
    assert [path.name for path in tmp_path.iterdir()] == ["statistics.nc"]
    with xarray.open_dataset(tmp_path / "statistics.nc") as dataset:
        assert set(dataset.data_vars) == {name.replace("/", "_") for name in statistics}
        for name, value in statistics.items():
            back = dataset[name.replace("/", "_")]
            assert back.dtype == value.dtype and np.array_equal(back.values, value)
        events, later = dataset["events"], dataset["error_by_step"]
        assert np.array_equal(
            events.sel(event="e_outside_E"), statistics["events"][EVENTS.index("e_outside_E")]
        )
        heading = later.sel(coordinate="heading", step=STEPS)
        assert np.array_equal(heading, statistics["error_by_step"][-1, 2])
        assert (
            heading.bucket.values[9] == histogram.EDGES[9]
            and heading.bucket_upper.values[9] == histogram.EDGES[10]
        )
        cloud = dataset["cloud"].sel(stage=2, plane="lateral,heading")
        assert np.array_equal(cloud, statistics["cloud"][1, 2])
        assert dataset["tube_outside_paper"].dims == ("stage",)


@pytest.mark.parametrize("missing", ["xarray", "h5netcdf", "h5py"])
def test_a_missing_library_is_named_with_its_cure(statistics, tmp_path, monkeypatch, missing):
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(ScenarioError, match=r"is not installed; pip install 'jaxtube\[results\]'"):
        netcdf.save(tmp_path / "statistics.nc", statistics)
    assert not any(tmp_path.iterdir())
