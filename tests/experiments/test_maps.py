"""Laws of `maps`: a grid that is a tree, points that survive an interruption, borders, and figures
of any outcome."""

import json
from concurrent.futures import ThreadPoolExecutor

import pytest
from pages import find_first_lines

from jaxtube.experiments.cli import main
from jaxtube.experiments.maps import command as maps
from jaxtube.experiments.maps import figures as maps_figures
from jaxtube.experiments.maps import points as maps_points
from jaxtube.experiments.maps.points import DESIGNS, Grid, Point, make_grid
from jaxtube.experiments.run.value_log import ValueLog
from jaxtube.scenario import ScenarioError, load
from jaxtube.synthesis.ratio import Guarantee, OperatingPoint

OWN = OperatingPoint(0.1, 1.224, 0.1)
IDENTITY = {"scenario": "certified"}
GRID = Grid((0.0, 0.1, 0.2), (0.3, 0.8, 1.224), (0.05, 0.1, 0.2), OWN)


def invented(design: str, scenario, start) -> Guarantee:
    """Return a ratio that grows with the slip error and with the speed range, and where the search
    started."""
    error = scenario.slip.relative_error
    slowest = scenario.reference.wheel_speed_min_mps
    period = scenario.controller.dt_s
    if design == "paper" and period > 0.15:
        return Guarantee(reason="none")
    least = {"paper": 3.0, "weighted": 1.0, "optimised": 0.5}[design]
    ratio = least + 2 * error + 0.5 * (1.224 - slowest) - 0.05
    ends = None if design != "optimised" else (error, slowest, period, *(start or ())[:3])
    return Guarantee(ratio, 1.0, "lateral error", "", "", ends)


@pytest.fixture
def in_threads(monkeypatch):
    """Invent the points, in threads; returns the points asked for and the starts given."""
    asked = []

    def note(design, scenario, start):
        asked.append((design, start))
        return invented(design, scenario, start)

    monkeypatch.setattr(maps_points, "guarantee", note)
    monkeypatch.setattr(maps_points, "_make_workers", lambda most: ThreadPoolExecutor(2))
    return asked


@pytest.fixture
def found(in_threads, tmp_path):
    with ValueLog(tmp_path / "points", IDENTITY) as log:
        return maps_points.compute(load("certified"), GRID, log)


def test_every_condition_starts_from_one_that_comes_before_it():
    operating_points = GRID.operating_points()
    assert len(operating_points) == len(set(operating_points)) == 3 * (3 + 3 - 1)
    assert operating_points[0] == OWN
    assert GRID.towards_own(OWN) is None
    for place, operating_point in enumerate(operating_points[1:], 1):
        neighbour = GRID.towards_own(operating_point)
        assert neighbour in operating_points[:place]
        assert (
            sum(here != there for here, there in zip(operating_point, neighbour, strict=True)) == 1
        )


@pytest.mark.parametrize("count", [2, 5])
def test_the_grid_holds_the_scenarios_own_condition_and_the_reference(count):
    scenario = load("certified")
    grid = make_grid(scenario, 1.224, count)
    assert grid.own == OWN
    ends = {"slip_error": (0, 0.3), "slowest_mps": (0.2, 1.224), "dt_s": (0.05, 0.2)}
    for name, values in grid.axes.items():
        assert getattr(OWN, name) in values
        assert (values[0], values[-1]) == ends[name]
        assert count <= len(values) <= count + 1


def test_the_grid_of_slip_intervals_widens_them_about_the_nominal_slips():
    scenario = load("husky")
    grid = make_grid(scenario, 0.538, 4)
    own = (0.0609 + 0.0022) / 2
    assert grid.slip_errors == pytest.approx((0.0, own, 2 * own, 3 * own), abs=1e-4)
    assert grid.own.slip_error in grid.slip_errors
    # The slowest wheel of the reference is all but the end of the scenario's own range.
    assert grid.slowest_mps[-1] == scenario.reference.wheel_speed_min_mps


def test_each_search_starts_from_its_neighbours_optimum(found):
    for operating_point in GRID.operating_points():
        start = found[Point("optimised", operating_point)].caps_and_gains
        neighbour = GRID.towards_own(operating_point)
        assert start is not None
        assert start[:3] == operating_point
        assert neighbour is None or start[3:] == neighbour


def test_an_interrupted_run_goes_on_and_ends_with_the_same_points(found, in_threads, tmp_path):
    entries = sorted((tmp_path / "points").glob("*.record"))
    assert len(entries) == len(GRID.points())
    for path in entries[11:]:
        path.unlink()
    entries[10].write_bytes(entries[10].read_bytes()[:-5])
    in_threads.clear()
    with ValueLog(tmp_path / "points", IDENTITY) as log:
        assert log.damaged == [f"{entries[10]}: is damaged; it is removed and computed again"]
        resumed = maps_points.compute(load("certified"), GRID, log)
    assert resumed == found
    assert len(in_threads) == len(entries) - 10
    with ValueLog(tmp_path / "points", IDENTITY) as log:
        assert len(log.records) == len(entries)


def test_points_of_another_run_are_refused(found, tmp_path):
    with pytest.raises(ScenarioError, match="points holds another run: scenario = "):
        ValueLog(tmp_path / "points", {"scenario": "paper"})


def test_a_failure_of_the_program_ends_the_run_and_keeps_what_was_done(
    monkeypatch, in_threads, tmp_path
):
    def fail_late(design, scenario, start):
        if design == "paper":
            raise ZeroDivisionError
        return invented(design, scenario, start)

    monkeypatch.setattr(maps_points, "guarantee", fail_late)
    with ValueLog(tmp_path / "points", IDENTITY) as log, pytest.raises(ZeroDivisionError):
        maps_points.compute(load("certified"), GRID, log)
    with ValueLog(tmp_path / "points", IDENTITY) as reopened:
        kept = [record["design"] for record in reopened.records]
    assert kept == [record["design"] for record in log.records]
    assert "optimised" in kept
    assert "paper" not in kept


def test_borders_are_those_of_the_ratio(found):
    border = maps.find_borders(GRID, found)
    # 0.5 + 2 r - 0.05 = 1 beyond the grid; 1 + 2 r - 0.05 = 1 at r = 0.025; 3 + ... never
    assert border["optimised"]["largest_slip_error_computed"] == 0.2
    assert border["weighted"]["largest_slip_error_computed"] == 0.0
    assert border["weighted"]["largest_slip_error_interpolated"] == pytest.approx(0.025)
    assert border["paper"]["largest_slip_error_computed"] is None
    # 0.5 + 0.2 + 0.5 (1.224 - v) - 0.05 = 1 at v = 0.524
    assert border["optimised"]["lowest_wheel_speed_mps_computed"] == 0.8
    assert border["optimised"]["lowest_wheel_speed_mps_interpolated"] == pytest.approx(0.524)
    report = maps.report(GRID, border, found, "slip error")
    assert set(["none:", "ratio", "2.95", "without", "slip", "error"]) <= set(report.split())


def test_a_point_without_a_design_ends_what_is_guaranteed():
    results = [Guarantee(0.5, 1.0), Guarantee(reason="none"), Guarantee(0.4, 1.0)]
    assert maps.interpolate(results, [0.0, 0.1, 0.2]) == (0.0, 0.0)
    too_fast = [Guarantee(0.5, 1.0), Guarantee(0.6, 1.1)]
    assert maps.interpolate(too_fast, [0.0, 0.1]) == (0.0, 0.0)


def test_the_ratio_map_shows_points_without_a_design_as_crosses(found):
    figure = maps_figures.ratio_map(GRID, found, "dt_s", "slip error")
    marks = [[line.get_marker() for line in axes.lines] for axes in figure.axes[:3]]
    assert [panel.count("x") for panel in marks] == [3, 0, 0]
    nothing = dict.fromkeys(found, Guarantee(reason="none"))
    maps_figures.ratio_map(GRID, nothing, "slowest_mps", "slip error")


def test_the_command_writes_figures_and_all_numbers(in_threads, tmp_path, capsys):
    assert main(["maps", "--points", "2", "--out", str(tmp_path)]) == 0
    names = {path.name for path in tmp_path.iterdir() if not path.name.startswith("points-")}
    figures = {f"ratio_{name}.{kind}" for name in ("speed", "period") for kind in ("png", "pdf")}
    reports = {"report.txt", "report.html"}
    assert names == figures | reports | {"scenario.toml", "manifest.json", "metrics.json"}
    verdict, printed = find_first_lines(tmp_path)
    assert verdict == printed
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert len(metrics["points"]) == len(DESIGNS) * 3 * (2 + 3 - 1)
    for point in metrics["points"]:
        assert point["holds"] == (point["ratio"] is not None and point["ratio"] < 1)
    assert "optimised caps and gains" in capsys.readouterr().out


@pytest.mark.slow
def test_two_points_an_axis_show_the_order_of_the_designs(tmp_path):
    assert main(["maps", "--points", "2", "--out", str(tmp_path)]) == 0
    points = json.loads((tmp_path / "metrics.json").read_text())["points"]
    own = {
        point["design"]: point
        for point in points
        if OperatingPoint(*(point[key] for key in OperatingPoint._fields)) == OWN
    }
    assert own["optimised"]["ratio"] < own["weighted"]["ratio"] < own["paper"]["ratio"]
