"""`montecarlo` through the door: its laps are those of `simulate`, with a controller and a slip
process of a user's own too; results are drawn, saved and read back."""

import jax.numpy as jnp
import numpy as np
import pytest
from figure_checks import assert_presentable
from own_slips import Worst
from tolerances import CLOSED_LOOP

import jaxtube as jt
from jaxtube import results
from jaxtube.coordinates import NAMES
from jaxtube.falsification.setting import make_setting
from jaxtube.statistics import montecarlo as door
from jaxtube.statistics import run as blocks
from jaxtube.statistics.montecarlo import make_closed_loop_task, name_law

BLOCK = 16
TILE = 8
LAPS = 20
SEED = 3


@pytest.fixture(scope="module", autouse=True)
def small_blocks():
    with pytest.MonkeyPatch.context() as patch:
        for module in (blocks, door):
            patch.setattr(module, "BLOCK", BLOCK)
        patch.setattr(blocks, "TILE", TILE)
        yield


@pytest.fixture(scope="module")
def design(uncertified):
    return uncertified("certified", "reference.duration_s=1", "noise.lateral_m=0.002")


@pytest.fixture(scope="module")
def law(design):
    """A controller of a user's own: a static gain."""
    gain = design.tube_gain.nominal
    return lambda errors, reference_wheels: errors @ gain.T


@pytest.fixture(scope="module")
def of_own_law(design, law):
    return jt.montecarlo(design, law, laps=LAPS, seed=SEED)


def assert_statistics_of(run, laps):
    """Compare a run with the laps of `simulate`."""
    E = run.design.problem.error_set
    normals = E.normals / np.linalg.norm(E.normals, axis=1, keepdims=True)
    offsets = E.offsets / np.linalg.norm(E.normals, axis=1)
    excess = (laps.errors[1:] @ normals.T - offsets).max(axis=(0, 1))
    np.testing.assert_allclose(run.statistics["excess/error"], excess, rtol=0, atol=CLOSED_LOOP)
    assert run.laps == laps.errors.shape[1] == LAPS
    assert run.share("e_outside_E").laps == laps.outside


def test_laps_of_an_own_controller_are_those_of_simulate(design, law, of_own_law):
    process = design.problem.scenario.slip.process
    assert of_own_law.law == ("own", "robot", "scenario", process, False, "")
    assert_statistics_of(of_own_law, jt.simulate(design, law, laps=LAPS, seed=SEED))


def test_laps_that_break_the_coupling_of_inputs_to_errors_alone_are_counted(design):
    def turn_hard(errors, reference_wheels):
        return jnp.stack([-errors[:, 0], jnp.full_like(errors[:, 0], 1.09)], axis=1)

    run = jt.montecarlo(design, turn_hard, laps=LAPS, seed=SEED)
    laps = jt.simulate(design, turn_hard, laps=LAPS, seed=SEED).trajectory
    assert np.all(design.problem.input_set.contains(laps.inputs.reshape(-1, 2)))
    section = design.problem.scenario.operating
    along = np.abs(laps.measured[:-1, :, 0]) / section.turning_longitudinal_m
    coupled = along + np.abs(laps.inputs[..., 1]) / section.turning_yaw_rate_radps
    assert run.share("u_outside_U").laps == np.sum(np.any(coupled > 1, axis=0)) == LAPS
    excess = section.turning_yaw_rate_radps * (np.max(coupled) - 1)
    assert np.max(run.statistics["excess/input"]) == pytest.approx(excess, abs=CLOSED_LOOP)


def test_laps_of_the_linear_plant_are_judged_by_the_caps_alone(design):
    """It is measured without noise, so the theorem is about what the controller keeps of E."""
    problem = design.problem
    assert np.all(problem.error_set.offsets > problem.operating_set.offsets)
    for plant, limits in {"linear": problem.operating_set, "robot": problem.error_set}.items():
        task = make_closed_loop_task(design, "local_gain", plant, "scenario", None, SEED)
        np.testing.assert_array_equal(task.checks.error.offsets, limits.offsets)
        setting = make_setting(design, "local_gain", plant)
        limit = setting.limits.of_laps["error"]
        np.testing.assert_array_equal(limit.offsets[0], limits.offsets)


def test_laps_of_an_own_slip_process_are_those_of_simulate(design, of_own_law):
    run = jt.montecarlo(design, "local_gain", slip=Worst(), laps=LAPS, seed=SEED)
    assert run.law == ("local_gain", "robot", "scenario", "own", False, "")
    laps = jt.simulate(design, "local_gain", slip=Worst(), laps=LAPS, seed=SEED)
    assert_statistics_of(run, laps)
    assert "slip (own)" in repr(run)


def test_the_verdict_comes_first(of_own_law):
    share = of_own_law.share("e_outside_E")
    assert repr(of_own_law).startswith(
        f"<MonteCarlo: 0 of {LAPS} laps left E (share at most {share.high:.3g} at 95 % confidence)"
    )
    assert "certificate of the design's tube-MPC, not of this controller: " in repr(of_own_law)
    with pytest.raises(ValueError, match="event = 'fire': is unknown; choose one of"):
        of_own_law.share("fire")


def test_of_a_law_without_qps_no_event_of_a_qp_is_counted(of_own_law):
    assert (
        not {"qp_infeasible", "qp_unsolved", "row_active", "backup"}
        & of_own_law.summary["events"].keys()
    )


def test_w_of_inputs_of_another_map_is_not_compared_with_W(design):
    """`compensated` takes u as the paper does, W of `certified` is that of u of its own map."""
    law = name_law(design, "compensated", "robot", "scenario")
    assert law.input_map == "paper"
    assert "so w is not W's" in law.describe(design.problem.scenario)
    own = name_law(design, "tube_mpc", "robot", "scenario")
    assert own.input_map == ""
    assert own.solves_qp


def test_a_run_is_drawn_saved_read_and_a_dataset(design, of_own_law, tmp_path, monkeypatch):
    assert_presentable(of_own_law.plot())
    monkeypatch.setattr(results, "design", lambda scenario: design)
    again = jt.read(of_own_law.save(tmp_path))
    assert repr(again) == repr(of_own_law)
    assert again.statistics.keys() == of_own_law.statistics.keys()
    dataset = again.to_xarray()
    assert dataset.identical(of_own_law.to_xarray())
    assert int(dataset["laps"]) == LAPS
    assert list(dataset["coordinate"].values) == list(NAMES)


@pytest.mark.parametrize(
    ("choices", "words"),
    [
        ({"controller": "mpc"}, "controller = 'mpc': is unknown"),
        ({"plant": "car"}, "plant = 'car': is unknown"),
        ({"plant": "linear", "slip": "iid"}, "draws no slips"),
        ({"starts": "somewhere"}, "starts = 'somewhere'"),
        ({"starts": np.zeros((LAPS, 3))}, "only jt.simulate takes initial errors"),
        ({"laps": 0}, "laps = 0: is no whole number"),
        ({"laps": 2.5}, "laps = 2.5: is no whole number"),
    ],
)
def test_what_cannot_run_is_refused_in_one_line(design, choices, words):
    with pytest.raises(ValueError, match=words) as refused:
        jt.montecarlo(design, **{"laps": LAPS, **choices})
    assert "\n" not in str(refused.value)
