"""Searches of a closed loop whose W, gains and caps go by speed: worst cases are those of their own
laps by the caps of each period's band, and gradients are those of finite differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxtube as jt
from jaxtube.falsification.ascent import find_uncertainties, make_mean_attack
from jaxtube.falsification.setting import make_setting
from jaxtube.plant.random_keys import make_key
from jaxtube.scenario import load, replace
from jaxtube.simulation.usage import play_limits

pytestmark = pytest.mark.slow  # every closed loop is compiled with its derivative

DRIVE = {
    "reference.wheel_speed_min_mps": 0.85,
    "reference.shape": "jumps",
    "reference.duration_s": 4,
    "initial.x_m": 0.08,
    "initial.y_m": 0.08,
}
ROUNDING = 1e-9
STEP = 1e-6
"""Of central differences, of deviations whose bounds are 1."""


@pytest.fixture(scope="module")
def design():
    scenario = load("certified_wide")
    return jt.design(replace(scenario, {**DRIVE, "operating.bands": scenario.operating.bands[4:]}))


@pytest.fixture(scope="module")
def found(design):
    return jt.falsify(design, seconds=8)


def find_used(design, lap) -> np.ndarray:
    """Return how much of the caps on inputs a lap uses in every period, from the numbers of the
    scenario alone."""
    used = []
    bands = design.problem.scenario.operating.bands
    wheels = design.problem.schedule
    for step, (u1, u2) in enumerate(lap.inputs[:, 0]):
        band = next(band for band in bands if wheels[step].mean() <= band.below_mps)
        e_x = lap.measured[step, 0, 0]
        shares = [
            u1 / band.speed_deficit_max_mps,
            u1 / band.speed_deficit_min_mps,
            abs(u2) / band.yaw_rate_deficit_radps,
            abs(e_x) / band.turning_longitudinal_m + abs(u2) / band.turning_yaw_rate_radps,
        ]
        used.append(max(shares))
    return np.array(used)


def test_no_limit_of_a_certified_design_is_left(found):
    assert set(found.rows) == {"error", "input", "wheels", "tube"}
    assert not found.is_violated
    for row in found.rows.values():
        assert row.worst.margin > -ROUNDING


def test_the_worst_input_is_that_of_its_lap_by_the_caps_of_the_bands(design, found):
    row = found.rows["input"]
    used = find_used(design, row.played.trajectory)
    assert row.worst.usage == pytest.approx(used.max(), abs=ROUNDING)
    assert used[row.worst.step] == pytest.approx(row.worst.usage, abs=ROUNDING)
    regimes = design.problem.period_regimes[: design.problem.reference.steps]
    assert len(np.unique(regimes)) == 2, "the lap meets both bands"


def test_the_worst_error_is_that_of_its_lap(design, found):
    row = found.rows["error"]
    limits = design.problem.error_set
    error = row.played.trajectory.errors[row.worst.step, 0]
    margins = limits.offsets - limits.normals @ error
    assert row.worst.margin == pytest.approx(margins[row.worst.facet], abs=ROUNDING)


def test_gradients_through_jumps_between_bands_are_finite_differences(design):
    """Of usages of every limit of a lap, in sum, along random directions of all that is bounded."""
    setting = make_setting(design)
    loop = setting.loop("error")
    uncertainties = find_uncertainties(loop.plant, setting.starts)
    middle = make_mean_attack(uncertainties, 1)
    generator = np.random.default_rng(0)
    places = {
        name: jnp.asarray(generator.uniform(-0.5, 0.5, values.shape))
        * np.ptp(uncertainties[name].by_time, axis=1).max(axis=0)
        for name, values in middle.items()
    }
    attack = {name: middle[name] + 0.5 * places[name] for name in middle}
    weights = {}

    @jax.jit
    def compute(attack):
        script = {name: values for name, values in attack.items() if name != "start"}
        keys = jax.random.split(make_key(0), 1)
        when = jnp.zeros(1, jnp.int32)
        usages = play_limits(loop, keys, attack["start"][0], when, script)
        draws = np.random.default_rng(1)
        for name in sorted(usages):
            weights.setdefault(name, draws.normal(size=usages[name].shape))
        return sum(jnp.sum(weights[name] * usages[name]) for name in usages)

    slope = jax.jit(jax.grad(compute))(attack)
    for seed in range(3):
        draws = np.random.default_rng(seed)
        way = {name: draws.normal(size=values.shape) for name, values in attack.items()}
        way = {name: way[name] * np.ptp(uncertainties[name].by_time) for name in way}
        ahead = compute({name: attack[name] + STEP * way[name] for name in attack})
        behind = compute({name: attack[name] - STEP * way[name] for name in attack})
        expected = (ahead - behind) / (2 * STEP)
        along = sum(jnp.sum(slope[name] * way[name]) for name in attack)
        assert float(along) == pytest.approx(float(expected), rel=1e-5)
