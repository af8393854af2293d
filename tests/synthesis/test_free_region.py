"""The region of free plans, by few rows, is the one that all rows leave."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxtube as jt
from jaxtube import qp
from jaxtube.simulation import components
from jaxtube.synthesis.free_region import find_free_regions


@pytest.fixture(scope="module", params=["paper", "certified"])
def design(request):
    return jt.design(jt.load(request.param))


def meets_all_rows(window, errors):
    slack = qp.TOLERANCE[8]
    values = errors @ window.free_rows.T
    checked = errors @ window.check_errors.T
    fits = (window.lower <= values) & (values <= window.upper)
    admissible = window.check_lower - slack <= checked
    admissible &= checked <= window.check_upper + slack
    return fits.all(axis=1) & admissible.all(axis=1)


@pytest.mark.parametrize("which", ["tube_qps", "plain_qps"])
def test_few_rows_say_what_all_say(design, which):
    qps = getattr(design, which)
    [regions] = find_free_regions(qps)
    generator = np.random.default_rng(5)
    for number in range(len(qps.lower)):
        window = jax.tree.map(lambda array, number=number: array[number], qps)
        normals = regions.normals[number]
        offsets = regions.offsets[number]
        directions = generator.normal(size=(4000, 3)) * design.problem.operating_set.support(
            np.eye(3)
        )
        reach = np.max((directions @ normals.T) / offsets, axis=1)
        # Beside each facet, a little inside and a little outside, and everywhere.
        for scale in (1 - 1e-6, 1 + 1e-6, 0.5, 2.0):
            errors = scale * directions / reach[:, None]
            found = np.all(errors @ normals.T <= offsets, axis=1)
            np.testing.assert_array_equal(found, scale < 1)
            np.testing.assert_array_equal(meets_all_rows(window, errors), found)


def test_the_rows_are_fewer(design):
    [regions] = find_free_regions(design.tube_qps)
    finite = (
        np.isfinite(design.tube_qps.lower[0]).sum() + np.isfinite(design.tube_qps.upper[0]).sum()
    )
    assert regions.offsets.shape[1] < finite / 2


def test_without_bounds_on_all_sides_every_row_stays(design):
    qps = design.tube_qps
    open_rows = np.tile([1.0, 0.0, 0.0], (*qps.free_rows.shape[:2], 1))
    nothing = qps.check_errors[:, :0]
    unbounded = qps._replace(
        free_rows=open_rows,
        check_errors=nothing,
        check_lower=nothing[..., 0],
        check_upper=nothing[..., 0],
    )
    [kept] = find_free_regions(unbounded)
    sides = np.isfinite(qps.lower[0]).sum() + np.isfinite(qps.upper[0]).sum()
    assert kept.offsets.shape[1] == sides


def test_controllers_of_one_design_share_their_shapes(design):
    tube = components.make_tube_mpc(design)
    plain = components.make_plain_mpc(design)
    shapes = [jax.tree.map(jnp.shape, mpc.qps.free_region) for mpc in (tube, plain)]
    assert shapes[0] == shapes[1]
