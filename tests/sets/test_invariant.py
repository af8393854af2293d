"""Laws of the invariant sets: no vertex loop leaves them, none is larger, and emptiness is shown by
a run."""

import functools

import numpy as np
import pytest
from paper_problem import W, terminal_problem
from scipy.optimize import linprog
from scipy.sparse import block_diag
from tolerances import TUBE_ROUNDING

from sets import few_facets as few_facets_module
from sets import invariant
from sets.few_facets import few_facet_rpi
from sets.invariant import INFLATION, maximal_rpi, minimal_rpi_bound
from sets.polytope import Polytope
from sets.tubes import hull_tube

SUPPORT_PROGRAM = 1e-8
"""Linear programs against their answer in exact arithmetic."""
MAXIMAL_SET = 1e-6
"""The set is built for a disturbance wider by as much."""
CLOSED_FORM = 1e-9

# (slowest wheel, lateral weights, objective): where a set exists, and where none does
FOUND = {
    "paper": (0.2, False, "trace_s"),
    "narrow": (0.4, False, "trace_s"),
    "lateral trace_p": (0.2, True, "trace_p"),
    "lateral logdet": (0.2, True, "logdet"),
}
EMPTY = {"trace_p": (0.2, False, "trace_p"), "logdet": (0.2, False, "logdet")}
PLANAR = (
    np.array([[[0.9, 0.3], [-0.2, 0.7]], [[0.8, -0.4], [0.3, 0.8]]]),
    Polytope(
        np.array([[1.0, 0.2], [-1.0, 0.1], [0.3, 1.0], [-0.2, -1.0]]),
        np.array([1.0, 1.2, 0.8, 1.0]),
    ),
    Polytope.box(np.array([-0.03, -0.01]), np.array([0.02, 0.04])),
)
each_found = pytest.mark.parametrize("case", FOUND)


@functools.cache
def maximal(case: str):
    return maximal_rpi(*terminal_problem(*{**FOUND, **EMPTY}[case]), W.support)


def given(found):
    """Return what was found, where something must have been."""
    assert found is not None
    return found


@functools.cache
def few_facets(case: str) -> Polytope:
    return given(
        few_facet_rpi(*terminal_problem(*FOUND[case]), W.support, given(maximal(case).polytope))
    )


def by_program(polytope: Polytope, rows: np.ndarray) -> np.ndarray:
    """Support numbers by linear programs, a row each and all solved as one."""
    every = block_diag([polytope.normals] * len(rows), format="csc")
    limits = np.tile(polytope.offsets, len(rows))
    answer = linprog(-rows.ravel(), A_ub=every, b_ub=limits, bounds=(None, None))
    assert answer.status == 0
    return np.sum(rows * answer.x.reshape(rows.shape), axis=1)


def width(disturbance: Polytope, rows: np.ndarray) -> np.ndarray:
    return np.max(rows @ disturbance.vertices().T, axis=1)


def least_room(polytope: Polytope, loops: np.ndarray, disturbance: Polytope) -> float:
    """Room that every vertex loop leaves inside the facets, relative to their offsets."""
    reach = np.max([by_program(polytope, polytope.normals @ loop) for loop in loops], axis=0)
    return np.min(
        (polytope.offsets - reach - width(disturbance, polytope.normals)) / polytope.offsets
    )


def directions(dimension: int, count: int = 100) -> np.ndarray:
    return np.random.default_rng(0).normal(size=(count, dimension))


def slow_maximal(
    loops: np.ndarray, constraints: Polytope, disturbance: Polytope, limit: int = 200
) -> Polytope:
    """Return the limit of O, O and its predecessors, ..., by operations on polytopes."""
    found = constraints.reduce()
    for _ in range(limit):
        room = found.pontryagin_difference(disturbance)
        smaller = functools.reduce(
            Polytope.intersect, [room.preimage(loop) for loop in loops], found
        ).reduce()
        if smaller.containment_margin(found) >= -TUBE_ROUNDING:
            return found
        found = smaller
    raise AssertionError("the slow iteration did not settle")


@each_found
def test_the_maximal_set_is_admissible_and_no_vertex_loop_leaves_it(case):
    loops, constraints = terminal_problem(*FOUND[case])
    assert maximal(case).escape is None
    found = given(maximal(case).polytope)
    assert constraints.containment_margin(found) >= -TUBE_ROUNDING
    if len(found.offsets) < 100:
        assert least_room(found, loops, W) >= -SUPPORT_PROGRAM
    points = found.vertices()
    for loop in loops:
        reached = (points @ loop.T)[:, None] + W.vertices()[None]
        assert found.contains(reached).all()


@pytest.mark.slow
def test_the_maximal_set_of_the_paper_is_invariant_by_linear_programs():
    assert (
        least_room(given(maximal("paper").polytope), terminal_problem(*FOUND["paper"])[0], W)
        >= -SUPPORT_PROGRAM
    )


@pytest.mark.parametrize("case", ["lateral trace_p", "lateral logdet", "planar"])
def test_the_maximal_set_equals_the_limit_of_a_slow_iteration(case):
    if case == "planar":
        loops, constraints, disturbance = PLANAR
    else:
        (loops, constraints) = terminal_problem(*FOUND[case])
        disturbance = W
    found = given(maximal_rpi(loops, constraints, disturbance.support).polytope)
    slow = slow_maximal(loops, constraints, disturbance)
    rows = directions(loops.shape[1])
    np.testing.assert_allclose(found.support(rows), slow.support(rows), rtol=MAXIMAL_SET)


@pytest.mark.parametrize("case", [*EMPTY, "planar 3", "planar 5"])
def test_emptiness_is_shown_by_a_run_from_the_origin_that_leaves(case):
    if case.startswith("planar"):
        loops = PLANAR[0]
        disturbance = PLANAR[2].scale(float(case[-1]))
        constraints = Polytope(PLANAR[1].normals, np.array([1.0, 1.2, 1.0, 0.7]))
        found = maximal_rpi(loops, constraints, disturbance.support)
    else:
        (loops, constraints) = terminal_problem(*EMPTY[case])
        disturbance = W
        found = maximal(case)
    assert found.polytope is None
    escape = given(found.escape)
    points = disturbance.vertices()
    member = np.all(constraints.normals == escape.normal, axis=1) & (
        constraints.offsets == escape.offset
    )
    assert member.any()
    row = escape.normal
    worst = []
    for index in (*reversed(escape.loops), None):
        worst.append(points[np.argmax(points @ row)])
        row = row if index is None else row @ loops[index]
    state = np.zeros(loops.shape[1])
    for index, chosen in zip((0, *escape.loops), reversed(worst), strict=True):
        state = loops[index] @ state + chosen
    assert escape.normal @ state > escape.offset
    assert not constraints.contains(state)


def test_the_iterations_that_prove_emptiness_are_those_the_reach_needs():
    assert {case: len(given(maximal(case).escape).loops) for case in EMPTY} == {
        "trace_p": 140,
        "logdet": 227,
    }


def test_too_few_iterations_leave_the_question_open(monkeypatch):
    monkeypatch.setattr(invariant, "MOST_ITERATIONS", 1)
    found = maximal_rpi(*terminal_problem(*FOUND["paper"]), W.support)
    assert (found.polytope, found.escape, found.iterations) == (None, None, 1)


def test_constraints_without_the_origin_inside_are_refused():
    outside = Polytope.box(np.array([0.1, -1.0]), np.array([1.0, 1.0]))
    with pytest.raises(ValueError, match="the origin must lie inside"):
        maximal_rpi(PLANAR[0], outside, PLANAR[2].support)


def two_scalars(first: float, second: float, steps: tuple[float, float]):
    """Two scalar systems x+ = a x + w, |w| <= steps, side by side."""
    box = Polytope.box(-np.array(steps), np.array(steps))
    return np.diag([first, second])[None], box


@pytest.mark.parametrize("first", [0.0, 0.5, -0.7, 0.95])
def test_a_scalar_system_has_the_minimal_set_of_the_geometric_series(first):
    loops, box = two_scalars(first, -0.3, (0.2, 0.1))
    axes = np.vstack([np.eye(2), -np.eye(2)])
    bound = given(minimal_rpi_bound(loops, box.support, axes))
    expected = np.array([0.2 / (1 - abs(first)), 0.1 / 0.7]) * (1 + INFLATION)
    np.testing.assert_allclose(bound.support(axes), np.tile(expected, 2), rtol=CLOSED_FORM)


@pytest.mark.parametrize("first", [0.5, -0.7, 0.95])
@pytest.mark.parametrize("share", [0.999, 1.001])
def test_a_scalar_system_has_an_invariant_set_exactly_where_its_minimal_one_fits(first, share):
    loops, box = two_scalars(first, 0.3, (share * (1 - abs(first)), 0.1))
    unit = Polytope.box(-np.ones(2), np.ones(2))
    found = maximal_rpi(loops, unit, box.support)
    if share > 1:
        assert found.polytope is None
        steps = len(given(found.escape).loops)
        reach = share * (1 - abs(first)) * sum(abs(first) ** m for m in range(steps + 1))
        assert reach > 1
        assert reach - share * (1 - abs(first)) * abs(first) ** steps <= 1 + INFLATION
    else:
        rows = directions(2)
        np.testing.assert_allclose(
            given(found.polytope).support(rows), unit.support(rows), rtol=CLOSED_FORM
        )


def test_an_alternating_scalar_system_keeps_the_part_whose_image_stays():
    loops, box = two_scalars(-0.9, 0.3, (0.05, 0.1))
    constraints = Polytope.box(np.array([-1.0, -1.0]), np.array([2.0, 1.0]))
    found = given(maximal_rpi(loops, constraints, box.support).polytope)
    reach = found.support(np.array([[1.0, 0.0], [-1.0, 0.0]]))
    np.testing.assert_allclose(reach, [0.95 / 0.9, 1.0], rtol=2 * INFLATION)


@each_found
def test_the_few_facet_set_is_invariant_and_large_inside_the_maximal_one(case, record_property):
    loops, constraints = terminal_problem(*FOUND[case])
    found = few_facets(case)
    assert len(found.offsets) <= 40
    assert least_room(found, loops, W) >= 0
    assert constraints.containment_margin(found) >= 0
    assert given(maximal(case).polytope).containment_margin(found) >= 0
    share = found.volume() / given(maximal(case).polytope).volume()
    record_property("volume_share", share)
    assert share >= 0.85


@pytest.mark.parametrize("facets", [12, 20, 30])
@pytest.mark.parametrize("case", ["paper", "lateral trace_p"])
def test_a_set_of_very_few_facets_is_invariant_and_admissible_or_not_given(case, facets):
    loops, constraints = terminal_problem(*FOUND[case])
    found = few_facet_rpi(loops, constraints, W.support, given(maximal(case).polytope), facets)
    if found is not None:
        assert len(found.offsets) <= facets
        assert least_room(found, loops, W) >= 0
        assert constraints.containment_margin(found) >= 0


def test_the_few_facet_set_for_more_facets_than_needed_is_the_maximal_one():
    whole = given(maximal("lateral trace_p").polytope)
    assert (
        few_facet_rpi(*terminal_problem(*FOUND["lateral trace_p"]), W.support, whole, facets=100)
        is whole
    )


def test_growth_stops_at_the_volume_asked_for(monkeypatch):
    monkeypatch.setattr(few_facets_module, "TARGET", 0.5)
    problem = terminal_problem(*FOUND["paper"])
    whole = given(maximal("paper").polytope)
    modest = given(few_facet_rpi(*problem, W.support, whole)).volume() / whole.volume()
    assert 0.5 <= modest < few_facets("paper").volume() / whole.volume()


@functools.cache
def minimal(case: str) -> Polytope:
    return given(
        minimal_rpi_bound(terminal_problem(*FOUND[case])[0], W.support, few_facets(case).normals)
    )


@each_found
def test_the_minimal_bound_is_invariant_and_inside_every_invariant_set_on_its_normals(case):
    bound = minimal(case)
    assert least_room(bound, terminal_problem(*FOUND[case])[0], W) >= 0
    assert few_facets(case).containment_margin(bound) >= 0


def test_the_minimal_bound_contains_the_tube_of_every_length():
    loops = terminal_problem(*FOUND["lateral trace_p"])[0]
    bound = minimal("lateral trace_p")
    for section in hull_tube(loops, W, 30)[1:]:
        assert (section.support(bound.normals) <= bound.offsets).all()


def test_the_minimal_bound_contains_every_simulated_deviation():
    rng = np.random.default_rng(1)
    loops = terminal_problem(*FOUND["lateral trace_p"])[0]
    bound = minimal("lateral trace_p")
    states = np.zeros((2000, 3))
    extreme = 0.0
    for _ in range(100):
        chosen = loops[rng.integers(len(loops), size=len(states))]
        states = np.einsum("rij,rj->ri", chosen, states) + rng.choice(
            W.vertices(), size=len(states)
        )
        assert bound.contains(states).all()
        extreme = max(extreme, np.max(states @ bound.normals.T / bound.offsets))
    assert extreme > 0.3


def test_no_minimal_bound_is_found_on_normals_that_carry_none():
    loops, _ = two_scalars(1.05, 0.3, (0.1, 0.1))
    axes = np.vstack([np.eye(2), -np.eye(2)])
    assert minimal_rpi_bound(loops, PLANAR[2].support, axes) is None


@pytest.mark.parametrize("disturbance", [PLANAR[2], [PLANAR[2]] * 2, [PLANAR[2].support] * 2])
def test_disturbances_are_sets_or_support_functions_one_or_one_a_loop(disturbance):
    loops, constraints, W = PLANAR
    expected = given(maximal_rpi(loops, constraints, W.support).polytope)
    found = given(maximal_rpi(loops, constraints, disturbance).polytope)
    np.testing.assert_array_equal(found.normals, expected.normals)
    bound = given(minimal_rpi_bound(loops, disturbance, expected.normals))
    least = given(minimal_rpi_bound(loops, W.support, expected.normals))
    np.testing.assert_array_equal(bound.offsets, least.offsets)


def test_what_has_no_support_function_and_a_wrong_number_of_sets_are_refused():
    loops, constraints, W = PLANAR
    with pytest.raises(TypeError, match=r"^disturbance: float has no support function; [^\n]*$"):
        maximal_rpi(loops, constraints, 0.3)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match=r"^disturbance: 3 sets for 2 loops; [^\n]*$"):
        maximal_rpi(loops, constraints, [W] * 3)


@pytest.mark.parametrize(
    "normals",
    [
        [[1.0, 0.0], [-1.0, 0.0]],
        [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0]],
        [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.6, 0.8]],
        [[1.0, 1.0], [2.0, 1.0], [1.0, 3.0], [1.0, 2.0]],
    ],
)
def test_normals_that_leave_a_direction_open_are_refused(normals):
    loops, _, W = PLANAR
    rows = np.array(normals)
    with pytest.raises(ValueError, match=r"^constraints: \d normals leave a direction open[^\n]*$"):
        maximal_rpi(loops, Polytope(rows, np.ones(len(rows))), W)
    with pytest.raises(ValueError, match=r"^normals: \d normals leave a direction open[^\n]*$"):
        minimal_rpi_bound(loops, W, rows)


def test_sets_of_one_dimension_are_refused():
    line = Polytope.box(-np.ones(1), np.ones(1))
    with pytest.raises(ValueError, match=r"^constraints: one dimension; [^\n]*$"):
        maximal_rpi(np.array([[[0.5]]]), line, line.scale(0.1))


@pytest.mark.parametrize("thickness", [0.0, 1e-300, 1e-12])
def test_a_flat_disturbance_has_a_maximal_set_and_its_minimal_bound_is_refused(thickness):
    loops, constraints, _ = PLANAR
    flat = Polytope.box(np.array([-0.03, -thickness]), np.array([0.02, thickness]))
    found = given(maximal_rpi(loops, constraints, flat).polytope)
    slow = slow_maximal(loops, constraints, flat)
    rows = directions(2)
    np.testing.assert_allclose(found.support(rows), slow.support(rows), rtol=MAXIMAL_SET)
    axes = np.vstack([np.eye(2), -np.eye(2)])
    with pytest.raises(ValueError, match=r"^disturbance: extent [^\n]* it is flat; [^\n]*$"):
        minimal_rpi_bound(loops, flat, axes)


def test_the_last_bits_choose_neither_spread_rows_nor_escapes():
    rng = np.random.default_rng(0)
    axes = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])
    octagon = np.vstack([axes, np.sqrt(2) * np.eye(2), -np.sqrt(2) * np.eye(2)])
    loops, box = two_scalars(0.9, 0.9, (0.3, 0.3))
    unit = Polytope.box(-np.ones(2), np.ones(2))
    escape = given(maximal_rpi(loops, unit, box).escape)
    for _ in range(20):
        noise = 1 + 1e-15 * rng.uniform(-1, 1, size=octagon.shape)
        chosen = few_facets_module._spread(octagon * noise, 5)
        np.testing.assert_allclose(chosen, few_facets_module._spread(octagon, 5), rtol=1e-14)
        bits = 1 + 1e-15 * rng.uniform(-1, 1, size=4)
        nearby = Polytope(unit.normals, unit.offsets * bits)
        found = given(maximal_rpi(loops, nearby, box).escape)
        np.testing.assert_array_equal(found.normal, escape.normal)
