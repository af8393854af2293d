"""A replayed lap is the lap of the run: its usage, its draws and its numbers are those that the run
recorded."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tolerances import CLOSED_LOOP

from jaxtube import qp
from jaxtube.experiments.cli import main
from jaxtube.experiments.montecarlo import lap_figure, replay
from jaxtube.figures.style import OUTSIDE
from jaxtube.plant.robot import saturate
from jaxtube.plant.slipping import SlipMemory
from jaxtube.simulation import components
from jaxtube.statistics import lap as laps
from jaxtube.statistics import run as montecarlo
from jaxtube.statistics.montecarlo import make_closed_loop_task
from jaxtube.statistics.run import Run

REPLAYED = 1e-9
"""Usage of a set by one lap alone against the same lap among others."""

SEED = 11
LAPS = 24
WORDS = ["montecarlo", "--controller", "local_gain", "--starts", "feasible", "--seed", str(SEED)]
DEGREES = np.array([1.0, 1.0, np.rad2deg(1.0)])


@pytest.fixture(scope="module")
def design(uncertified):
    return uncertified("paper")


@pytest.fixture(scope="module")
def task(design):
    return make_closed_loop_task(design, "local_gain", "robot", "feasible", None, SEED)


@pytest.fixture
def known(design, task, monkeypatch):
    """Hand out the design and the task of these tests to the command, where it asks for them."""

    def make_task(*arguments):
        assert arguments == (design, "local_gain", "robot", "feasible", None, SEED)
        return task

    monkeypatch.setattr(
        "jaxtube.experiments.montecarlo.command.make_design", lambda scenario, options: design
    )
    monkeypatch.setattr("jaxtube.experiments.montecarlo.replay.make_closed_loop_task", make_task)


@pytest.fixture(scope="module")
def lap(design, task):
    return laps.lap(design, task, SEED, 5)


def test_laps_by_their_numbers_are_those_of_the_run(design, task, lap):
    """A lap is the same beside any others, whatever their order; numbers reach to 2^64."""
    numbers = [2**63 + 1, 5, 0]
    several = laps.run_numbered(task, SEED, numbers)
    assert several.errors.shape[1] == len(numbers)
    np.testing.assert_allclose(several.errors[:, 1], lap.trajectory.errors, rtol=0, atol=REPLAYED)
    far = laps.lap(design, task, SEED, 2**63 + 1).trajectory.errors
    np.testing.assert_allclose(several.errors[:, 0], far, rtol=0, atol=REPLAYED)


@pytest.mark.parametrize(("run_laps", "count"), [(1, 40), (3, 40), (500, 10), (500, 2)])
def test_the_worst_lap_is_among_those_worth_a_look(run_laps, count):
    ranked = [{"lap": number, "usage": 1.0} for number in (run_laps - 1, 0, run_laps // 2)]
    summary = {"laps": run_laps, "worst": {"error": ranked, "disturbance": ranked[::-1]}}
    chosen = laps.choose_numbers(summary, count)
    assert run_laps - 1 in chosen
    assert chosen == sorted(set(chosen)) and max(chosen) < run_laps
    assert len(chosen) == min(count, run_laps)


def test_the_worst_laps_use_again_what_the_run_recorded(design, task, monkeypatch):
    for name in ("BLOCK", "TILE"):
        monkeypatch.setattr(montecarlo, name, 2 * LAPS)
    run = Run(task, LAPS, 1, tuple(jax.devices()[:1]))
    ((_, statistics),) = run.collect([0], run.dispatch([0]))
    for kind, used in (
        ("error", lambda lap: lap.of_error_set),
        ("disturbance", lambda lap: lap.of_disturbance_set),
    ):
        worst = statistics[f"worst_lap/{kind}"][:2]
        assert len(set(worst)) == 2
        assert max(worst) < LAPS
        for number, usage in zip(worst, statistics[f"worst_usage/{kind}"], strict=False):
            again = used(laps.lap(design, task, SEED, int(number)))
            assert again.share.max() == pytest.approx(usage, abs=REPLAYED)
            assert again.outside.any() == (usage > 1 + REPLAYED)


def test_the_slips_of_a_lap_move_the_robot_along_its_path(design, task, lap):
    plant = task.plant
    assert np.all(np.abs(lap.slips) <= 1)
    assert np.all(lap.slips[:, 1] == 0)
    assert np.std(lap.slips[:, 0]) > 0.5
    errors = jnp.asarray(lap.trajectory.errors[:-1])
    wheels = saturate(jnp.asarray(lap.trajectory.demanded), plant.robot)
    true = jnp.asarray(lap.slips[:, 0])
    memory = SlipMemory((), true, jnp.zeros_like(true))
    following = jax.vmap(plant.move)(jnp.arange(len(true)), errors, wheels, memory)
    assert following == pytest.approx(lap.trajectory.errors[1:], abs=CLOSED_LOOP)
    assert wheels == pytest.approx(lap.trajectory.wheels, abs=CLOSED_LOOP)


def test_laps_beyond_four_thousand_million_are_laps_of_their_own(design, task, lap):
    far = laps.lap(design, task, SEED, 2**32 + 5)
    assert np.max(np.abs(far.trajectory.errors[0] - lap.trajectory.errors[0])) > 1e-3
    again = laps.lap(design, task, SEED, 2**32 + 5)
    assert np.array_equal(far.trajectory.errors, again.trajectory.errors)


def test_usage_is_that_of_the_coordinate_furthest_out(design, lap):
    for usage, limits, values in (
        (lap.of_error_set, design.problem.error_set, lap.trajectory.errors[1:]),
        (lap.of_disturbance_set, design.problem.disturbance_set, lap.disturbance),
    ):
        relative = np.abs(values) / limits.support(np.eye(3))
        assert usage.share == pytest.approx(relative.max(axis=1))
        assert np.array_equal(usage.by_coordinate, relative > 1 + REPLAYED)
        assert np.array_equal(usage.outside, usage.by_coordinate.any(axis=1))


def test_the_report_names_the_largest_values_and_when(design, lap):
    text = replay.text(design, lap)
    step = int(np.argmax(np.abs(lap.disturbance[:, 2])))
    (row,) = [line.split() for line in text.splitlines() if line.startswith("w_th [deg]")]
    assert float(row[2]) == pytest.approx(np.rad2deg(abs(lap.disturbance[step, 2])), rel=1e-4)
    assert row[3] == "0.2"
    assert float(row[5]) == pytest.approx((step + 1) * design.problem.reference.dt)
    outside = int(lap.of_disturbance_set.outside.sum())
    assert outside > 0
    assert f"W: left in {outside} of {len(lap.disturbance)} periods" in text
    assert "E, limits of the true error: |e_x| 0.3 m, |e_y| 0.3 m, |e_th| 20 deg\n" in text
    assert "QPs" not in text
    assert "reached in 0 of" in text
    planned = replay.text(design, lap._replace(plans=True))
    assert f"{len(lap.disturbance)} solved, 0 infeasible" in planned


def test_qps_without_solution_and_wheels_at_their_limits_are_counted(design, lap):
    status = lap.trajectory.diagnostics.status.copy()
    status[:3] = qp.INFEASIBLE
    status[3] = qp.UNSOLVED
    demanded = lap.trajectory.demanded.copy()
    demanded[7:9] = 9.0
    diagnostics = lap.trajectory.diagnostics._replace(status=status)
    trajectory = lap.trajectory._replace(diagnostics=diagnostics, demanded=demanded)
    text = replay.text(design, lap._replace(plans=True, trajectory=trajectory))
    assert "3 infeasible, 1 unsolved" in text
    assert "reached in 2 of" in text


def test_a_lap_is_drawn_with_its_errors_its_disturbances_and_their_limits(design, lap):
    figure = lap_figure.draw(design.problem, lap)
    panels = np.reshape(figure.axes, (4, 3))
    worst = int(np.argmax(lap.of_error_set.share)) + 1
    for i, limit in enumerate((0.3, 0.3, 20.0)):
        curve, ring, *levels = panels[1, i].lines
        assert curve.get_ydata() == pytest.approx(lap.trajectory.errors[:, i] * DEGREES[i])
        assert ring.get_xydata()[0] == pytest.approx(
            (worst * 0.1, lap.trajectory.errors[worst, i] * DEGREES[i])
        )
        assert [level.get_ydata()[0] for level in levels] == pytest.approx([-limit, limit])
    settled = 100 + int(np.argmax(lap.of_error_set.share[99:]))
    for axes in panels[2]:
        diamond = axes.lines[1]
        assert diamond.get_xdata()[0] == pytest.approx(0.1 * settled)
        assert axes.get_xlim() == pytest.approx((10.0, 30.0))
    limits = (5.0, 5.0, 0.2)
    outside = lap.of_disturbance_set.by_coordinate
    for i, axes in enumerate(panels[3]):
        inside, beyond, *levels = axes.lines
        assert len(inside.get_xdata()) + len(beyond.get_xdata()) == len(lap.disturbance)
        assert len(beyond.get_xdata()) == outside[:, i].sum()
        assert beyond.get_color() == OUTSIDE
        assert np.all(np.abs(beyond.get_ydata()) > limits[i])
        assert [level.get_ydata()[0] for level in levels] == pytest.approx([-limits[i], limits[i]])
    assert panels[0, 1].lines[1].get_ydata() == pytest.approx(lap.trajectory.wheels[:, 0])
    assert panels[0, 2].lines[1].get_ydata() == pytest.approx(20 + 2 * lap.slips[:, 0, 1])


def test_a_lap_of_the_linear_plant_shows_its_inputs(design, task):
    linear = dataclasses.replace(task, plant=components.linear_plant(design))
    lap = laps.lap(design, linear, SEED, 0)
    assert np.all(np.isnan(lap.trajectory.wheels))
    assert not lap.of_disturbance_set.outside.any()
    assert lap.slips is None
    assert "wheels" not in replay.text(design, lap)
    panels = np.reshape(lap_figure.draw(design.problem, lap).axes, (4, 3))
    for i in range(2):
        assert panels[0, 1 + i].lines[0].get_ydata() == pytest.approx(lap.trajectory.inputs[:, i])


def test_the_command_adds_to_the_folder_of_a_run_and_takes_nothing_away(
    known, lap, tmp_path, capsys
):
    before = {name: name.encode() for name in ("metrics.json", "manifest.json", "scenario.toml")}
    for name, content in before.items():
        (tmp_path / name).write_bytes(content)
    words = [*WORDS, "--out", str(tmp_path)]
    assert main([*words, "--replay", "5"]) == 0
    assert {name: (tmp_path / name).read_bytes() for name in before} == before
    assert {path.name for path in tmp_path.iterdir()} == set(before) | {
        f"replay-5.{kind}" for kind in ("png", "pdf", "npz", "txt")
    }
    printed = capsys.readouterr().out
    assert printed.startswith(f"lap 5; seed {SEED}; drawn from local_gain")
    assert printed.startswith((tmp_path / "replay-5.txt").read_text())
    saved = np.load(tmp_path / "replay-5.npz")
    assert np.array_equal(saved["errors"], lap.trajectory.errors)
    assert np.array_equal(saved["slip_deviations"], lap.slips)
    assert main([*words, "--replay", str(2**64)]) == 2
    assert "--replay" in capsys.readouterr().err


@pytest.mark.parametrize(("laps_of_run", "said"), [(5, True), (6, False)])
def test_a_lap_beyond_the_run_is_said_to_be(
    known, tmp_path, monkeypatch, capsys, laps_of_run, said
):
    monkeypatch.setattr(replay, "refuse_another_run", lambda *arguments: None)
    (tmp_path / "identity.json").write_text("{}")
    (tmp_path / "metrics.json").write_text(f'{{"laps": {laps_of_run}}}')
    assert main([*WORDS, "--out", str(tmp_path), "--replay", "5"]) == 0
    line = f"lap 5 is beyond the run in {tmp_path}/, which has 5 laps"
    assert (line in capsys.readouterr().out) == said


def test_a_folder_that_cannot_be_made_is_refused(known, tmp_path, capsys):
    (tmp_path / "file").touch()
    assert main([*WORDS, "--replay", "5", "--out", str(tmp_path / "file" / "run")]) == 2
    assert "name a folder you may write to" in capsys.readouterr().err
