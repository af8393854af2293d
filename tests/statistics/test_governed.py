"""Laws of governed robots: whatever is asked for, there is a plan in every period, and nothing
leaves what is promised; without the governor both fail."""

from functools import partial

import numpy as np
import pytest
import wishes

import jaxtube as jt
from jaxtube import qp
from jaxtube.simulation.governing import LivePlanner, accept_all, govern
from jaxtube.statistics.governed import run_governed
from jaxtube.synthesis.feasible import shortfall, spread_starts, true_starts

ROBOTS = 64
PERIODS = 3


@pytest.fixture(scope="module")
def design():
    return jt.design(jt.load("certified", ["reference.duration_s=6"]))


@pytest.fixture(scope="module")
def planner(design):
    return LivePlanner(design)


@pytest.fixture(scope="module")
def corners(design):
    return true_starts(design.tube_qps, design.first_window, design.problem)


def first_window(design):
    return design.windows.schedules[design.first_window]


def drive(design, corners, wish, robots=ROBOTS, periods=PERIODS, seed=0, process="vertex", **way):
    starts = spread_starts(corners, robots, seed, edge_share=1.0)
    return run_governed(
        design, starts, first_window(design), wish, periods, seed, process=process, **way
    )


@pytest.mark.slow
def test_whatever_is_asked_for_there_is_a_plan_and_nothing_leaves_its_set(design, planner, corners):
    run = drive(design, corners, wishes.AdversarialWishes(planner))
    assert run.periods == ROBOTS * PERIODS
    assert run.without_plan == 0
    assert sum(run.outside.values()) == 0
    assert run.shares[1.0] < run.periods


def test_without_a_governor_plans_are_lost_and_inputs_leave_their_set(design, planner, corners):
    run = drive(design, corners, wishes.AdversarialWishes(planner), decide=accept_all)
    assert run.without_plan > 0
    assert run.outside["U"] > 0


def test_a_governor_that_never_asks_for_a_plan_is_found_out(design, planner, corners, monkeypatch):
    plan = planner.plan

    def claim(windows, errors):
        plans = plan(windows, errors)
        return plans._replace(status=np.full_like(plans.status, qp.SOLVED))

    errors = spread_starts(corners, ROBOTS, 0, edge_share=1.0)
    wished = wishes.AdversarialWishes(planner)(0, errors)
    committed = np.tile(first_window(design), (ROBOTS, 1, 1))
    monkeypatch.setattr(planner, "plan", claim)
    broken = govern(planner, errors, committed, wished)
    monkeypatch.undo()
    assert np.all(broken.shares == 1.0)
    assert np.any(planner.plan(broken.windows, errors).status != qp.SOLVED)


def test_from_the_terminal_set_every_window_has_a_plan(design, planner):
    """At its corners, along corners of the box and what lies between them."""
    corners = design.terminal.invariant.vertices()
    errors = np.tile(corners, (8, 1))
    generator = np.random.default_rng(0)
    for draw in wishes.LAWS.values():
        windows = draw(generator, planner.live.box, len(errors), design.problem.horizon)
        assert np.all(planner.plan(windows, errors).status == qp.SOLVED)


def test_there_is_a_plan_where_linear_programs_say_so(design, planner, corners):
    """Against linear programs over the rows."""
    errors = spread_starts(corners, 40, 5, edge_share=1.0)
    windows = wishes.draw_corners(
        np.random.default_rng(1), planner.live.box, len(errors), design.problem.horizon
    )
    plans = planner.plan(windows, errors)
    qps = planner.live.condense(windows).qps
    short = np.array([shortfall(qps, robot, error) for robot, error in enumerate(errors)])
    assert np.array_equal(plans.status == qp.SOLVED, short <= 1e-9)
    assert len(set(plans.status.tolist())) > 1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["certified", "certified_20"])
def test_a_million_periods_of_any_wishes_have_a_plan(name, capsys):
    """Of each law of wishes and of slips: short runs from the edge, where plans are lost, and long
    ones."""
    design = jt.design(jt.load(name, ["reference.duration_s=6"]))
    corners = true_starts(design.tube_qps, design.first_window, design.problem)
    planner = LivePlanner(design)
    laws = {law: partial(wishes.Wishes, draw, planner) for law, draw in wishes.LAWS.items()}
    laws["adversarial"] = partial(wishes.AdversarialWishes, planner)
    total = 0
    for law, make in laws.items():
        for process in ("iid", "vertex", "adversarial", "constant"):
            for robots, periods, seeds in ((2000, 8, 4), (50, 300, 1)):
                counts = {"governed": 0, "ungoverned": 0}
                for seed in range(seeds):
                    for way, decide in (("governed", govern), ("ungoverned", accept_all)):
                        run = drive(
                            design,
                            corners,
                            make(seed),
                            robots,
                            periods,
                            seed,
                            process,
                            decide=decide,
                        )
                        counts[way] += run.without_plan
                        if way == "governed":
                            total += run.periods
                            assert run.without_plan == 0
                            assert sum(run.outside.values()) == 0
                with capsys.disabled():
                    print(name, law, process, robots * seeds, periods, counts, total, flush=True)
    assert total >= 1_200_000
