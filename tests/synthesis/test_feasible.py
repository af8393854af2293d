"""Laws of the feasible set's probes: its boundary is where an exact solver loses the plan, and
starts lie within."""

import numpy as np
import pytest
from oracles import TIGHT, PlainMpc
from scipy.spatial import ConvexHull
from tolerances import CLOSED_LOOP, LINEAR_PROGRAM

from jaxtube.synthesis.feasible import boundary, reach_of_ray, shortfall, spread_starts

COUNT = 60


@pytest.fixture(scope="module", params=["robust", "tight"])
def probed(request, uncertified):
    """(design, QP of its first step by plain simulation, boundary points)."""
    design = uncertified("robust", *(TIGHT if request.param == "tight" else ()))
    points = boundary(
        design.tube_qps, int(design.windows.index[0]), design.problem.error_set, COUNT, seed=2
    )
    return design, PlainMpc(design).qp(0), points


def test_just_inside_the_boundary_an_exact_solver_has_a_plan_and_just_outside_none(probed):
    design, qp, points = probed
    E = design.problem.error_set
    by_e = 0
    by_rows = 0
    for point in points:
        assert E.contains(point, CLOSED_LOOP) and qp.solve(point * (1 - LINEAR_PROGRAM)) is not None
        beyond = 1.01 * point
        if E.contains(beyond):
            assert qp.solve(beyond) is None and qp.shortfall(beyond) > 0
            by_rows += 1
        else:
            by_e += 1
    # Of `robust` the rows cut little of E; where wheels are slow they cut more.
    assert by_rows >= COUNT / 10 and by_e > 0


def test_shortfall_is_what_the_rows_lack_of_a_plan(probed):
    design, qp, points = probed
    window = int(design.windows.index[0])
    for point, factor in zip(points, np.linspace(0.5, 2, COUNT), strict=True):
        found = shortfall(design.tube_qps, window, factor * point)
        assert found == pytest.approx(qp.shortfall(factor * point), abs=LINEAR_PROGRAM)
        assert (found > 0) == (qp.solve(factor * point) is None)


def test_a_ray_ends_where_its_end_says_whatever_the_length_of_the_direction(probed):
    design, qp, points = probed
    window = int(design.windows.index[3])
    for direction in points[:10]:
        reach = reach_of_ray(design.tube_qps, window, direction)
        assert reach >= 1 - LINEAR_PROGRAM
        assert reach_of_ray(design.tube_qps, window, 3 * direction) == pytest.approx(reach / 3)
        assert abs(qp.shortfall(reach * direction)) <= LINEAR_PROGRAM


def test_where_not_even_the_origin_has_a_plan_rays_end_at_once(probed):
    design, _, points = probed
    window = design.tube_qps
    index = int(design.windows.index[0])
    impossible = window._replace(upper=window.lower - 0.1 * np.isfinite(window.lower))
    assert reach_of_ray(impossible, index, points[0]) == 0
    assert shortfall(impossible, index, np.zeros(3)) > 0


def test_boundary_points_follow_the_seed_and_lie_all_around(probed):
    design, _, points = probed
    window = int(design.windows.index[0])
    E = design.problem.error_set
    np.testing.assert_array_equal(boundary(design.tube_qps, window, E, COUNT, seed=2), points)
    assert not np.any(np.all(boundary(design.tube_qps, window, E, COUNT, seed=3) == points, axis=1))
    assert len(np.unique(np.sign(points), axis=0)) == 8


def test_starts_lie_in_the_hull_of_the_boundary_in_E_and_have_a_plan(probed):
    design, qp, points = probed
    starts = spread_starts(points, 300, 5)
    facets = ConvexHull(np.vstack([points, np.zeros(3)])).equations
    assert np.max(starts @ facets[:, :3].T + facets[:, 3]) <= CLOSED_LOOP
    assert design.problem.error_set.contains(starts).all()
    assert all(qp.solve(start) is not None for start in starts)


def test_start_i_is_a_function_of_seed_and_i(probed):
    points = probed[2]
    starts = spread_starts(points, 50, 5)
    np.testing.assert_array_equal(spread_starts(points, 20, 5), starts[:20])
    assert not np.any(np.all(spread_starts(points, 50, 6) == starts, axis=1))
    assert len(np.unique(starts, axis=0)) == 50


def test_the_edge_share_says_how_many_starts_are_close_to_the_edge(probed):
    """The gauge of the hull of the boundary points: 1 on its surface, 0 at the origin."""
    points = probed[2]
    facets = ConvexHull(points).equations

    def gauge(share):
        return np.max(
            spread_starts(points, 400, 7, share) @ facets[:, :3].T / -facets[:, 3], axis=1
        )

    assert np.median(gauge(1.0)) > 0.8 and gauge(1.0).max() <= 0.999 + CLOSED_LOOP
    assert np.median(gauge(0.0)) < 0.8 and gauge(0.0).min() < 0.2
    assert (
        0.3
        < np.mean(
            np.all(
                np.isclose(spread_starts(points, 400, 7, 0.5), spread_starts(points, 400, 7, 1.0)),
                axis=1,
            )
        )
        < 0.7
    )
