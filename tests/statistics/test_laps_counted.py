"""Laws of the Monte Carlo blocks: their statistics are what numpy counts in recorded laps, however
they were run."""

import dataclasses
import hashlib
import itertools
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from doubtful import Doubtful
from recount import join, recount, recount_plans
from tolerances import CLOSED_LOOP, COUNTED

from jaxtube.coordinates import PLANES
from jaxtube.scenario import load
from jaxtube.simulation import components
from jaxtube.simulation.rollout import Trajectory, realisation_keys, run_laps
from jaxtube.statistics import run as montecarlo
from jaxtube.statistics import tally
from jaxtube.statistics.events import EVENT_NAMES, find_row
from jaxtube.statistics.montecarlo import make_closed_loop_task
from jaxtube.statistics.run import RANKED, WORST, Run, first_plan, merge, plan_steps
from jaxtube.statistics.task import facets, input_facets
from jaxtube.synthesis.design import design
from jaxtube.synthesis.limits import InputRows
from jaxtube.synthesis.parts import Design
from sets.polytope import Polytope

COUNTED_ROUNDING = 1e-10
"""Extremes, which are sums in another order; a lap's rounding grows over its steps."""
SOLVED_ROUNDING = 1e-8
"""The same where a solver of residual 1e-8 answers."""
PLAN_OF_ORACLE = 1e-6
"""Relative; plans of the batched solver against an active-set method."""

BLOCK = 128
TILE = 64
SEED = 6
SHORT = "reference.duration_s=3"
NOISE = ("noise.longitudinal_m=0.001", "noise.lateral_m=0.002", "noise.heading_deg=0.1")


@pytest.fixture(scope="module", autouse=True)
def small_blocks():
    """Blocks small enough to record all their laps, and plans at more than one step."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(montecarlo, "BLOCK", BLOCK)
        patch.setattr(montecarlo, "TILE", TILE)
        patch.setattr(montecarlo, "PLANS_SHARE", 0.1)
        yield


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class PoisonedStart:
    """Starts of which that of one realisation, named by the words of its key, is no number."""

    inner: Any
    victim: Any

    def draw(self, keys):
        hit = jnp.all(jax.random.key_data(keys) == self.victim, axis=1)
        return jnp.where(hit[:, None], jnp.nan, self.inner.draw(keys))


def poison(task, lap):
    victim = jax.random.key_data(realisation_keys(SEED, lap, 1))[0]
    return dataclasses.replace(task, starts=dataclasses.replace(task.starts, victim=victim))


class Case(NamedTuple):
    """A task, and the sets that its laps are counted against."""

    design: Design
    task: montecarlo.Task
    sets: dict[str, Polytope]
    input_rows: InputRows

    def run(self, realisations, chunk=1):
        return Run(self.task, realisations, chunk, (jax.devices()[0],))


def scaled(polytope, factor):
    return Polytope(polytope.normals, factor * polytope.offsets)


def couple(input_set, spread):
    """Return the rows of a set of inputs and of |e_x| / `spread` + |u2| / its cap <= 1."""
    zeros = np.zeros((len(input_set.offsets), 3))
    turning = np.array([0.0, 1.0]) / input_set.support(np.array([[0.0, 1.0]]))
    signs = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])
    along = np.array([1 / spread, 0.0, 0.0])
    return InputRows(
        np.concatenate([input_set.normals, signs[:, :1] * turning]),
        np.concatenate([zeros, signs[:, 1:] * along]),
        np.concatenate([input_set.offsets, np.ones(4)]),
    )


def make_case(found, controller, spread, most_mps):
    """Build a case in which everything happens: narrower sets and slower wheels than those of the
    design, wide starts, and a stage cost against which plans do not always improve."""
    task = make_closed_loop_task(found, controller, "robot", "feasible", None, SEED)
    problem = found.problem
    sets = {
        "disturbance": scaled(problem.disturbance_set, 1.2),
        "error": scaled(problem.error_set, 0.8),
    }
    rows = couple(scaled(problem.input_set, 0.4), spread=0.05)
    checks = dataclasses.replace(
        task.checks,
        **{name: jax.device_put(facets(polytope)) for name, polytope in sets.items()},
        input=jax.device_put(input_facets(rows)),
        ultimate=jnp.array([0.02, 0.05, 0.02]),
        settled=20,
        command_step=jnp.array(0.2),
        error_weight=2.5 * task.checks.error_weight,
    )
    robot = dataclasses.replace(task.plant.robot, wheel_speed_max=most_mps)
    plant = dataclasses.replace(task.plant, robot=robot)
    inner = dataclasses.replace(task.starts, triangles=spread * task.starts.triangles)
    starts = PoisonedStart(inner, jnp.zeros(2, jnp.uint32))
    narrowed = dataclasses.replace(task, plant=plant, starts=starts, checks=checks)
    return Case(found, narrowed, sets, rows)


@jax.jit
def draw_starts(starts, keys):
    return starts.draw(keys)


def record(task, first, count=BLOCK) -> Trajectory:
    """Return the laps from the one numbered `first` on."""
    found = []
    for begin in range(first, first + count, TILE):
        keys = realisation_keys(SEED, begin, TILE)
        starts = draw_starts(task.starts, keys)
        laps = run_laps(task.controller, task.plant, keys, starts)
        found.append(jax.tree.map(np.asarray, laps))
    return jax.tree.map(lambda *arrays: np.concatenate(arrays, axis=1)[:, :count], *found)


def check_same(statistics, expected, rounding=COUNTED_ROUNDING):
    """Compare counts exactly and extremes to rounding."""
    for name, value in expected.items():
        if np.asarray(statistics[name]).dtype.kind == "i":
            np.testing.assert_array_equal(statistics[name], value, err_msg=name)
        else:
            np.testing.assert_allclose(
                statistics[name], value, rtol=rounding, atol=rounding, err_msg=name
            )


def as_bytes(statistics):
    return {
        name: (array.dtype.str, array.shape, array.tobytes()) for name, array in statistics.items()
    }


# -------------------------------------------------------------------------- a block of the tube-MPC


VICTIM = 41
PARTIAL = 100


@pytest.fixture(scope="module")
def constrained(uncertified):
    """The tube-MPC from starts in and around its feasible set; both slips walk, pose noise, wheels
    that saturate."""
    settings = (
        SHORT,
        *NOISE,
        "slip.process=walk",
        "slip.random=both",
        "slip.relative_error=0.2",
        "controller.horizon=3",
    )
    return make_case(uncertified("robust", *settings), "tube_mpc", 1.1, 2.1)


@pytest.fixture(scope="module")
def poisoned(constrained):
    """The same with a lap that starts from no number."""
    return constrained._replace(task=poison(constrained.task, VICTIM))


@pytest.fixture(scope="module")
def blocks(poisoned):
    """The statistics of a whole block and of a partial one."""
    return dict(poisoned.run(BLOCK + PARTIAL).compute([0, 1]))


@pytest.fixture(scope="module")
def laps(poisoned):
    return {0: record(poisoned.task, 0), 1: record(poisoned.task, BLOCK, PARTIAL)}


@pytest.mark.parametrize("block", [0, 1])
def test_a_block_of_the_tube_mpc_counts_what_its_laps_do(poisoned, blocks, laps, block):
    expected = recount(poisoned, laps[block], block * BLOCK)
    check_same(blocks[block], expected, SOLVED_ROUNDING)
    # Every event happens in some laps, and most not in all: no count holds trivially.
    for name, row in zip(EVENT_NAMES, expected["events"], strict=True):
        if name == "slip_outside_interval":
            assert row[1:].sum() == 0  # no slip is learnt here
        elif block == 0 or name not in ("not_finite", "qp_unsolved"):
            assert row[1:].sum() > 0, name
        assert row.sum() == (BLOCK, PARTIAL)[block]
    assert np.mean(expected["events"][:, 0] > 0) > 0.8
    assert expected["starts_that_left"].sum() > 0 and np.count_nonzero(expected["map"]) > 100


def test_a_lap_that_is_no_number_is_a_violation_and_the_worst_of_all(blocks, laps):
    assert (
        np.isnan(laps[0].errors[:, VICTIM]).all()
        and np.isnan(laps[0].errors[0]).any(axis=-1).sum() == 1
    )
    found = blocks[0]
    steps = len(laps[0].inputs)
    for name in (
        "e_outside_E",
        "e_outside_lateral",
        "w_outside_W",
        "u_outside_U",
        "not_finite",
        "backup",
    ):
        assert found["events"][find_row(name), steps] >= 1, name
    np.testing.assert_array_equal(
        found["events"][find_row("not_finite")], [BLOCK - 1, *[0] * (steps - 1), 1]
    )
    for name in ("error", "disturbance"):
        assert found[f"worst_lap/{name}"][0] == VICTIM and found[f"worst_usage/{name}"][0] == np.inf
        assert np.isfinite(found[f"worst_usage/{name}"][1:]).all()
    assert all(
        np.isfinite(found[f"excess/{name}"]).all() for name in ("error", "disturbance", "input")
    )


def run_with_a_spoilt_lap(task, errors):
    """Return the laps from given starts, and those of the same batch with one start that is no
    number; both without that lap."""
    keys = realisation_keys(SEED, 0, TILE)
    others = np.arange(TILE) != VICTIM

    def run(starts):
        laps = run_laps(task.controller, task.plant, keys, jnp.asarray(starts))
        return jax.tree.map(np.asarray, laps)

    clean = run(errors)
    spoilt = run(np.where(others[:, None], errors, np.nan))
    assert np.isnan(spoilt.errors[:, VICTIM]).all()
    return [jax.tree.map(lambda array: array[:, others], laps) for laps in (clean, spoilt)]


def check_companions(task, errors, everything_free, rounding):
    """Compare laps with those beside one that is no number: to rounding, or to the bit."""
    clean, spoilt = run_with_a_spoilt_lap(task, errors)
    assert everything_free == (not clean.diagnostics.active.any())
    for name in ("errors", "measured", "inputs", "wheels", "demanded"):
        value = getattr(spoilt, name)
        expected = getattr(clean, name)
        if rounding:
            np.testing.assert_allclose(value, expected, rtol=0, atol=rounding, err_msg=name)
        else:
            assert value.tobytes() == expected.tobytes(), name
    for name in ("status", "active", "backup"):
        value = getattr(spoilt.diagnostics, name)
        expected = getattr(clean.diagnostics, name)
        np.testing.assert_array_equal(value, expected, err_msg=name)


@pytest.mark.parametrize(
    "rounding",
    [
        # Compiled quickly, two branches of a program may round the same sum otherwise.
        pytest.param(CLOSED_LOOP, id="rounding"),
        pytest.param(0.0, id="bits", marks=pytest.mark.slow),
    ],
)
def test_no_lap_feels_a_companion_that_is_no_number(constrained, laps, rounding):
    clean = np.where(np.isnan(laps[0].errors[0, :TILE]), 0.01, laps[0].errors[0, :TILE])
    check_companions(constrained.task, clean, everything_free=False, rounding=rounding)
    plant = constrained.task.plant
    slips = dataclasses.replace(plant.slips, half_width=0.1 * plant.slips.half_width)
    calm = dataclasses.replace(plant, slips=slips, noise=0.01 * plant.noise)
    task = dataclasses.replace(constrained.task, plant=calm)
    check_companions(task, 0.02 * clean, everything_free=True, rounding=rounding)


# ----------------------------------------------------------------------------------- plans followed


@pytest.mark.parametrize("block", [0, 1])
def test_plans_followed_count_what_an_exact_solver_s_plans_do(poisoned, blocks, laps, block):
    count = (BLOCK, PARTIAL)[block]
    first = block * BLOCK
    assert plan_steps(30, poisoned.design.problem.horizon) == (3, 9)
    parts = []
    for tile, begin in enumerate(range(0, count, TILE)):
        end = min(begin + TILE, count)
        some = jax.tree.map(lambda array, begin=begin, end=end: array[:, begin:end], laps[block])
        keys = realisation_keys(SEED, first + begin, end - begin)
        stop = (block * BLOCK // TILE + tile) * 7 % 9
        parts.append(
            recount_plans(poisoned, some, keys, (stop, stop + 9, stop + 18), first + begin)
        )
    expected = join(parts)
    check_same(blocks[block], expected, PLAN_OF_ORACLE)
    assert 0 < expected["plans"] < 3 * count
    assert 0 < expected["cost_excesses"] < expected["plans"] and expected["cost_excess"] > 0
    for name in poisoned.design.tubes:
        assert np.all(
            (expected[f"tube_outside/{name}"] > 0)
            & (expected[f"tube_outside/{name}"] < expected["plans"])
        )
    assert np.all(expected["cloud"].sum(axis=(2, 3)) > 0.2 * expected["plans"])


@pytest.mark.parametrize(("steps", "horizon"), [(300, 5), (300, 20), (30, 5), (6, 5), (10_000, 5)])
def test_plans_of_many_tiles_begin_at_every_state_with_a_horizon_ahead(monkeypatch, steps, horizon):
    monkeypatch.setattr(montecarlo, "PLANS_SHARE", 0.01)
    plans, distance = plan_steps(steps, horizon)
    assert plans == max(round(steps / 100), 1) and distance >= 1
    first = [int(first_plan(jnp.asarray(tile, jnp.int32), distance)) for tile in range(distance)]
    stops = sorted({stop + distance * i for stop in first for i in range(plans)})
    assert stops == list(range(plans * distance)) and len(stops) >= steps - horizon - plans
    assert stops[-1] + horizon <= steps
    # Few tiles are spread out already.
    assert distance < 16 or np.diff(sorted(first[:8])).max() < distance / 3


@pytest.mark.parametrize("steps", [5, 4, 1])
def test_no_plan_is_followed_where_the_reference_ends_before_it(steps):
    assert plan_steps(steps, 5)[0] == 0


@pytest.mark.slow
def test_while_w_stays_in_W_no_tube_and_no_E_is_left(uncertified):
    design = uncertified("robust", SHORT)
    task = make_closed_loop_task(design, "tube_mpc", "linear", "feasible", None, SEED)
    run = Run(task, 4 * BLOCK, 1, (jax.devices()[0],))
    found = [statistics for _, statistics in run.compute(range(4))]
    joined = merge(merge(found[0], found[1]), merge(found[2], found[3]))
    assert joined["laps"] == 4 * BLOCK and joined["plans"] == 3 * joined["laps"]
    for name in (
        "w_outside_W",
        "e_outside_E",
        "u_outside_U",
        "qp_infeasible",
        "qp_unsolved",
        "backup",
    ):
        assert joined["events"][find_row(name), 1:].sum() == 0, name
    for name in design.tubes:
        assert joined[f"tube_outside/{name}"].sum() == 0
        assert joined[f"tube_excess/{name}"].max() <= COUNTED
        # The law says something only where deviations come close to the sets.
        assert joined[f"tube_excess/{name}"].max() > -1e-4
    assert joined["excess/disturbance"].max() <= COUNTED and joined["excess/error"].max() <= 0
    assert (
        joined["cost_excesses"] == joined["next_plan_missing"] == 0
        and joined["events"][find_row("row_active"), 1:].sum() > 0
    )
    assert joined["events"][find_row("outside_ultimate_bound"), 1:].sum() == 0


# -------------------------------------------------------------------------- whatever the way it ran


STATIC = (SHORT, *NOISE, "slip.process=patches")


@pytest.fixture(scope="module")
def static(uncertified):
    """A static gain on patches of ground: compiles in seconds."""
    return make_case(uncertified("robust", *STATIC), "equal_gain", 1.0, 2.1)


@pytest.fixture(scope="module")
def first_blocks(static):
    return [as_bytes(found) for _, found in static.run(3 * BLOCK + 5).compute(range(4))]


@pytest.mark.parametrize("first", [0, 2**31 - BLOCK, 2**31, 2**32 - BLOCK, 2**32, 2**40 + 2**32])
def test_a_block_counts_the_laps_of_its_own_numbers(static, first_blocks, first):
    found = dict(static.run(2**53).compute([first // BLOCK]))[first // BLOCK]
    check_same(found, recount(static, record(static.task, first), first))
    assert (as_bytes(found) == first_blocks[0]) == (first == 0)
    assert found["plans"] == 0 and found["worst_lap/tube"].size == 0


def test_keys_are_distinct_around_the_ends_of_a_word():
    firsts = (0, 2**31 - 64, 2**32 - 64, 2**33 - 64, 2**52)
    words = np.concatenate(
        [jax.random.key_data(realisation_keys(SEED, first, 128)) for first in firsts]
    )
    assert len(np.unique(words, axis=0)) == len(words)


def test_a_partial_block_counts_only_its_laps_and_no_others_change(static, first_blocks):
    for realisations in (1, 5, TILE, BLOCK - 1):
        [(_, found)] = static.run(realisations).compute([0])
        check_same(found, recount(static, record(static.task, 0, realisations), 0))
        assert len(found["worst_lap/error"]) == min(WORST, realisations)
    longer = [as_bytes(found) for _, found in static.run(5 * BLOCK).compute(range(4))]
    assert longer[:3] == first_blocks[:3] and longer[3] != first_blocks[3]


def test_blocks_come_in_the_order_asked_for(static, first_blocks):
    found = list(static.run(3 * BLOCK + 5).compute(iter([3, 0, 2])))
    assert [(number, as_bytes(value)) for number, value in found] == [
        (i, first_blocks[i]) for i in (3, 0, 2)
    ]
    assert list(static.run(5).compute([])) == []


@pytest.mark.parametrize("far", [0.0, np.inf])
def test_a_block_with_an_unsolved_qp_is_that_of_the_whole_program(static, paper_design, far):
    inner = components.controllers(paper_design)["compensated"]
    whole = Doubtful(inner, jnp.array(far))
    case = static._replace(task=dataclasses.replace(static.task, controller=whole))
    found = dict(case.run(2 * BLOCK).compute([0, 1]))
    runs = whole if far == 0.0 else whole.without_rounds()
    played = dataclasses.replace(case.task, controller=runs)
    for number, statistics in found.items():
        first = number * BLOCK
        check_same(statistics, recount(case, record(played, first), first))


@pytest.mark.slow
def test_two_blocks_at_once_give_the_same_bytes(static, first_blocks):
    found = dict(static.run(3 * BLOCK + 5, chunk=2).compute([0, 1, 3]))
    assert {number: as_bytes(value) for number, value in found.items()} == {
        i: first_blocks[i] for i in (0, 1, 3)
    }


def digest(found):
    return hashlib.sha256(repr(found).encode()).hexdigest()


@pytest.mark.slow
def test_any_number_of_devices_and_blocks_at_once_gives_the_same_bytes(first_blocks):
    tests = Path(__file__).parents[1]
    child = subprocess.run(
        [sys.executable, __file__],
        env={**os.environ, "PYTHONPATH": str(tests)},
        capture_output=True,
        text=True,
    )
    assert child.returncode == 0, child.stderr
    assert child.stdout.split() == [digest(first_blocks)] * 4


# ------------------------------------------------------------------------------------------ joining


def random_statistics(random, part):
    """Draw statistics of a range of laps; usages are rounded, so that many are equal, and some are
    infinite."""
    found = {
        "events": random.integers(0, 2**40, (3, 5)),
        "laps": np.array(random.integers(1, 600)),
        "excess/error": np.where(random.random(6) < 0.2, -np.inf, random.normal(size=6)),
        "cost_excess": np.array(random.normal()),
    }
    for name in RANKED:
        laps = random.permutation(100)[: random.integers(0, WORST + 1)] + 100 * part
        values = np.where(
            random.random(len(laps)) < 0.1, np.inf, random.integers(0, 8, len(laps)) / 4
        )
        order = np.lexsort((laps, -values))
        found |= {f"worst_usage/{name}": values[order], f"worst_lap/{name}": laps[order]}
    return found


@pytest.mark.parametrize("seed", range(20))
def test_joining_is_associative_and_commutative_to_the_bit(seed):
    random = np.random.default_rng(seed)
    parts = [random_statistics(random, part) for part in range(4)]
    expected = as_bytes(merge(merge(merge(*parts[:2]), parts[2]), parts[3]))
    for a, b, c, d in itertools.permutations(parts):
        assert as_bytes(merge(merge(a, b), merge(c, d))) == expected
        assert as_bytes(merge(a, merge(b, merge(c, d)))) == expected


def test_joining_adds_counts_takes_the_extremes_and_keeps_the_worst_laps():
    random = np.random.default_rng(0)
    parts = [random_statistics(random, part) for part in range(2)]
    joined = merge(*parts)
    assert set(joined) == set(parts[0])
    for name in ("events", "laps"):
        np.testing.assert_array_equal(joined[name], parts[0][name] + parts[1][name])
    np.testing.assert_array_equal(
        joined["excess/error"], np.maximum(*(part["excess/error"] for part in parts))
    )
    for name in RANKED:
        pairs = [
            (-u, lap)
            for p in parts
            for u, lap in zip(p[f"worst_usage/{name}"], p[f"worst_lap/{name}"], strict=True)
        ]
        expected = sorted(pairs)[:WORST]
        assert expected == list(
            zip(-joined[f"worst_usage/{name}"], joined[f"worst_lap/{name}"], strict=True)
        )


if __name__ == "__main__":
    # The process with four devices: it prints a digest of the same blocks for several ways of
    # computing them.
    import conftest  # noqa: F401

    from sets.certificate import Certificate

    jax.config.update("jax_num_cpu_devices", 4)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("jaxtube.synthesis.design.certify", lambda *sets: Certificate())
        designed = design(load("robust", STATIC))
    montecarlo.BLOCK = BLOCK
    montecarlo.TILE = TILE
    montecarlo.PLANS_SHARE = 0.1
    case = make_case(designed, "equal_gain", 1.0, 2.1)
    for count, chunk in ((1, 1), (1, 4), (4, 1), (3, 2)):
        run = Run(case.task, 3 * BLOCK + 5, chunk, tuple(jax.devices()[:count]))
        print(digest([as_bytes(found) for _, found in run.compute(range(4))]))


def test_starts_on_the_faces_of_the_box_count_in_the_cells_within(static):
    box = static.task.checks.error
    faces = np.diag(box.upper) * (1 - 1e-12)
    inside = np.concatenate([faces, -faces, np.diag(box.upper) * (1 + 1e-12)])
    outside = np.concatenate([1.01 * faces, -1.01 * faces, [[np.nan, 0.0, 0.0]]])
    cover = jax.jit(tally._coverage)
    for starts, counted in ((inside, True), (outside, False)):
        counts = jnp.ones(len(starts), jnp.int32)
        found = np.asarray(cover(static.task.checks, jnp.asarray(starts), counts))
        # A start outside along one axis is inside in the plane of the others.
        along = [np.sum(np.any(starts[:, list(plane)] != 0, axis=1)) for plane in PLANES]
        expected = len(starts) - (0 if counted else np.array(along))
        np.testing.assert_array_equal(found.sum(axis=(1, 2)), expected)
