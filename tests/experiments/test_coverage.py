"""Laws of `coverage`: what is reported is a share of what both sets hold, and certified."""

import json
from typing import Any

import numpy as np
import pytest

from jaxtube.experiments.__main__ import main
from jaxtube.experiments.coverage import figures, report
from jaxtube.experiments.coverage import measure as measuring
from jaxtube.experiments.coverage.measure import Extent, measure
from jaxtube.scenario import load
from jaxtube.synthesis.design import design
from jaxtube.synthesis.feasible import project_feasible_set, reach_of_ray
from sets.polytope import Polytope

TIMED = measuring._time_step


class Log:
    """Values in memory."""

    def __init__(self):
        self.records = []

    def append(self, record):
        self.records.append(json.loads(json.dumps(record)))


@pytest.fixture(scope="module")
def scenario():
    return load("certified", ["reference.duration_s=2"])


@pytest.fixture(scope="module", autouse=True)
def untimed():
    """Laps are compiled for their time alone; the slow test has them run."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measuring, "_time_step", lambda made, seed: 0.25)
        yield


@pytest.fixture(scope="module")
def sets(scenario):
    log: Any = Log()
    return measure(scenario, Extent((1, 3), 0), log)


def test_coverage_grows_with_the_horizon_and_is_below_one(sets):
    largest = sets["control_invariant"]["volume"]
    shares = [record["covered"] / largest for record in sets["horizons"]]
    assert shares == sorted(shares)
    assert 0.2 < shares[0] < shares[1] < 1
    assert [record["failing"] for record in sets["horizons"]] == [[], []]


def test_known_horizons_are_not_measured_again(scenario, sets):
    log: Any = Log()
    log.records = [{"horizon": None, **sets["control_invariant"]}, *sets["horizons"]]
    assert measure(scenario, Extent((1, 3), 0), log) == sets
    assert len(log.records) == 3


def test_the_projected_feasible_set_agrees_with_rays(scenario):
    made = design(scenario)
    caps = made.problem.operating_set
    found = project_feasible_set(made.tube_qps, 0, caps)
    inner = found.inner.with_unit_normals()
    directions = np.random.default_rng(0).normal(size=(40, 3)) * caps.support(np.eye(3))
    for direction in directions:
        reach = reach_of_ray(made.tube_qps, 0, direction)
        reach = min(reach, 1 / np.max(caps.normals @ direction / caps.offsets))
        of_hull = 1 / np.max(inner.normals @ direction / inner.offsets)
        assert of_hull <= reach * (1 + 1e-6)
        assert reach <= of_hull * (1 + found.gap) * (1 + 1e-6)


def test_the_report_names_the_best_certified_horizon(sets):
    corners = Polytope.box(-np.ones(3), np.ones(3)).vertices()
    assert "at horizon 3" in report.say_verdict(sets)
    failing = [{**record, "failing": ["recursion"]} for record in sets["horizons"]]
    assert "no horizon" in report.say_verdict({**sets, "horizons": failing})
    nothing = [*sets["horizons"], {"horizon": 9, "volume": None, "reason": "E_1 is empty"}]
    text = report.write({**sets, "horizons": nothing})
    assert "E_1 is empty" in text
    assert max(map(len, text.splitlines())) <= 100
    figures.draw_coverage({**sets, "horizons": nothing}, corners)
    report.make_page(sets)
    without = {"volume": 0.0, "corners": [], "steps": 1, "settled": True}
    uncovered = [{**record, "covered": None} for record in sets["horizons"]]
    alone = {**sets, "control_invariant": without, "horizons": uncovered}
    figures.draw_coverage(alone, corners)
    assert "-" in report.write(alone)


@pytest.mark.parametrize("horizons", ["", "0,3", "3,", "a", "100"])
def test_horizons_that_are_none_are_refused(horizons, capsys):
    assert main(["coverage", "--horizons", horizons]) == 2
    assert "whole numbers from 1 to 99" in capsys.readouterr().err


@pytest.mark.slow
def test_the_command_writes_its_figure_and_numbers(sets, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(measuring, "_find_largest", lambda problem: sets["control_invariant"])
    assert (
        main(["coverage", "--horizons", "1", "--out", str(tmp_path), "reference.duration_s=1"]) == 0
    )
    names = {path.name for path in tmp_path.iterdir()}
    assert {"coverage.png", "report.txt", "report.html", "metrics.json"} <= names
    assert "certified coverage: " in capsys.readouterr().out


@pytest.mark.slow
def test_a_step_takes_time(scenario):
    assert 0.01 < TIMED(design(scenario), 0) < 100


def test_what_a_plan_keeps_beyond_the_largest_set_does_not_count(sets):
    largest = Polytope.from_vertices(np.array(sets["control_invariant"]["corners"]))
    longest = sets["horizons"][-1]
    common = Polytope.from_vertices(np.array(longest["corners"])).intersect(largest)
    assert longest["covered"] == pytest.approx(common.volume(), rel=3e-4)
    assert longest["covered"] < 0.9995 * longest["volume"]
