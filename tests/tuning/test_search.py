"""Laws of the searches without gradients: exact budgets, points by index, no worse than the start,
no crash."""

import numpy as np
import pytest

from jaxtube.tuning.search import log_grid, nelder_mead, random_point, random_search

START = np.array([1.0, -2.0, 0.5])
SCALES = np.array([0.5, 2.0, 0.1])


def bowl(point):
    return float(np.sum((point - [0.5, -1.0, 0.7]) ** 2 * [1.0, 10.0, 3.0]))


def holes(point):
    """A bowl with a region that is not a number and one that is infinite."""
    if point[0] > 1.2:
        return np.nan
    if point[1] < -2.2:
        return -np.inf
    return bowl(point)


class Counted:
    def __init__(self, objective):
        self.objective = objective
        self.points = []

    def __call__(self, point):
        self.points.append(np.array(point))
        point_value = self.objective(point)
        point[:] = np.nan  # an objective may do with its argument what it likes
        return point_value


def searches(budget):
    return {
        "random": lambda objective: random_search(objective, START, SCALES, budget, seed=4),
        "simplex": lambda objective: nelder_mead(objective, START, budget, size=0.3),
    }


# ------------------------------------------------------------------------------
# both searches


@pytest.mark.parametrize("method", ["random", "simplex"])
@pytest.mark.parametrize("budget", [1, 2, 4, 5, 57, 700])
def test_the_budget_is_used_up_exactly_and_the_best_point_returned(method, budget):
    objective = Counted(bowl)
    search = searches(budget)[method](objective)
    values = [bowl(point) for point in objective.points]
    assert len(values) == budget == len(search.values)
    np.testing.assert_array_equal(search.points, objective.points)
    np.testing.assert_array_equal(search.values, values)
    assert search.value == min(values) == bowl(search.best) <= bowl(START) == values[0]


@pytest.mark.parametrize("method", ["random", "simplex"])
def test_values_that_are_not_finite_count_as_infinite(method):
    search = searches(300)[method](holes)
    values = np.array([holes(point) for point in search.points])
    expected = np.where(np.isfinite(values), values, np.inf)
    np.testing.assert_array_equal(search.values, expected)
    assert np.isinf(search.values).any() and search.value == bowl(search.best) < bowl(START)


@pytest.mark.parametrize("method", ["random", "simplex"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 3.0])
def test_a_plane_is_searched_to_the_end_and_the_start_returned(method, value):
    search = searches(80)[method](lambda point: value)
    assert len(search.values) == 80
    np.testing.assert_array_equal(search.best, START)


@pytest.mark.parametrize("search", searches(0).values())
def test_a_budget_of_nothing_is_refused(search):
    with pytest.raises(ValueError, match="budget = 0"):
        search(bowl)


# ------------------------------------------------------------------------------
# each search


def test_a_random_point_depends_on_seed_and_index_alone():
    short = random_search(bowl, START, SCALES, 20, seed=4).points
    long = random_search(bowl, START, SCALES, 50, seed=4).points
    np.testing.assert_array_equal(short, long[:20])
    np.testing.assert_array_equal(long[33], random_point(START, SCALES, 4, 33))
    other = random_search(bowl, START, SCALES, 20, seed=5).points
    assert (other[1:] != short[1:]).all()


def test_random_points_are_normal_around_the_start():
    points = random_search(bowl, START, SCALES, 4000, seed=1).points
    deviations = (points - START) / SCALES
    assert np.abs(deviations.mean(axis=0)).max() < 5 / np.sqrt(4000)
    np.testing.assert_allclose(np.cov(deviations.T), np.eye(3), atol=0.12)


def test_the_simplex_begins_at_its_size():
    points = nelder_mead(bowl, START, 4, size=0.3).points
    np.testing.assert_array_equal(points, [START, *(START + 0.3 * np.eye(3))])


def test_the_simplex_finds_the_optimum():
    np.testing.assert_allclose(
        nelder_mead(bowl, START, 400, size=0.3).best, [0.5, -1.0, 0.7], atol=1e-6
    )


@pytest.mark.parametrize("size", [0.0, np.nan, np.inf])
def test_a_simplex_without_volume_is_refused(size):
    with pytest.raises(ValueError, match="size = "):
        nelder_mead(bowl, START, 10, size)


# ------------------------------------------------------------------------------
# grid


def test_the_grid_is_full_and_spans_the_decades():
    centre = np.array([2.0, 30.0, 0.1, 1.0])
    grid = log_grid(centre, np.array([1.0, 2.0, 0.5, 1.0]), (5, 2, 3, 1))
    assert grid.shape == (30, 4) and len(np.unique(grid, axis=0)) == 30
    np.testing.assert_allclose(np.unique(grid[:, 0]), 2.0 * 10.0 ** np.array([-1, -0.5, 0, 0.5, 1]))
    np.testing.assert_allclose(np.unique(grid[:, 1]), [0.3, 3000.0])
    np.testing.assert_allclose(np.unique(grid[:, 2]), 0.1 * 10.0 ** np.array([-0.5, 0, 0.5]))
    np.testing.assert_array_equal(grid[:, 3], 1.0)
    np.testing.assert_array_equal(grid[:3, :2], np.repeat(grid[:1, :2], 3, axis=0))
    assert (log_grid(centre, 1.5, (3, 3, 5, 1)) == centre).all(axis=1).sum() == 1


@pytest.mark.parametrize(
    "centre, shape", [([1.0, 2.0], (3,)), ([1.0, 0.0], (3, 3)), ([1.0, 2.0], (3, 0))]
)
def test_a_grid_that_cannot_be_is_refused(centre, shape):
    with pytest.raises(ValueError, match=r"(shape|centre) = "):
        log_grid(np.array(centre), 1.0, shape)
