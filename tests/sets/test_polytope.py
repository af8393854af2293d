"""Polytope operations against brute force, on random polytopes of dimension 1-4: flat, badly
scaled, with duplicates.

A case is drawn in coordinates of unit size, where the oracles work: vertices by all subsets of
rows, depth by a linear program. The polytope under test is its image under S = diag(scales), so
that x = S y and h_P(d) = max d S y.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from itertools import combinations

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial import ConvexHull

from sets import frame
from sets.polytope import Polytope, convex_hull, hull_vertices
from tests.tolerances import SET_RELATIVE

SET_CHEBYSHEV = 1e-8
"""Radii, found by a linear program; support numbers of unbounded sets."""
SET_DECIDED = 1e-7
"""Margin below which an oracle does not decide emptiness or membership."""
SET_NEAR_DUPLICATE = 1e-9
"""Merged points and rows."""
SET_SAME_POINT = 1e-8
"""Distance below which brute force takes two vertices for one."""

LAWS = 9
CASES = 64 * LAWS
"""Every law takes one case in nine; the kinds recur with period 64, so it meets each once."""


@dataclass(frozen=True)
class Case:
    """P = S Y with Y the hull of points, {y : rows y <= limits}; other = S Z likewise, with
    interior."""

    scales: np.ndarray
    rows: np.ndarray
    limits: np.ndarray
    points: np.ndarray
    polytope: Polytope
    other_rows: np.ndarray
    other_limits: np.ndarray
    other_points: np.ndarray
    other: Polytope
    flat: bool
    plain: bool
    rng: np.random.Generator

    @property
    def size(self):
        """Size of the coordinates y that enter the arithmetic."""
        return 1 + abs(self.points).max() + abs(self.other_points).max()

    def directions(self, count=20):
        return np.vstack(
            [
                self.rng.normal(size=(count, len(self.scales))) / self.scales,
                np.eye(len(self.scales)),
            ]
        )

    def assert_support(self, polytope, directions, numbers):
        """Compare support numbers relative to the size of the set in each direction."""
        error = abs(polytope.support(directions) - numbers)
        assert (error <= SET_RELATIVE * self.size * (abs(directions) @ self.scales)).all(), (
            error.max()
        )

    def numbers(self, directions, points):
        return (directions * self.scales @ points.T).max(axis=1)


def brute_force_vertices(rows, limits):
    """Vertices of a bounded {y : rows y <= limits} by solving every square subset of rows."""
    dimension = rows.shape[1]
    if dimension == 0:
        return np.zeros((1, 0))
    subsets = np.array(list(combinations(range(len(rows)), dimension)))
    regular = subsets[abs(np.linalg.det(rows[subsets])) > 1e-7]
    points = np.linalg.solve(rows[regular], limits[regular][..., None])[..., 0]
    points = points[(points @ rows.T <= limits + 1e-10).all(axis=1)]
    near = abs(points[:, None] - points[None]).max(axis=2) < SET_SAME_POINT
    return points[~np.tril(near, -1).any(axis=1)]


def depth(rows, limits, weights):
    """Largest r for which some y has rows y + r weights <= limits."""
    return -linprog(
        -np.eye(rows.shape[1] + 1)[-1],
        np.column_stack([rows, weights]),
        limits,
        bounds=(None, None),
    ).fun


def random_rows(rng, dimension):
    """A box cut by random half-spaces, some of which only touch a vertex."""
    cuts = rng.normal(size=(rng.integers(1, 6), dimension))
    rows = np.vstack(
        [np.eye(dimension), -np.eye(dimension), cuts / np.linalg.norm(cuts, axis=1, keepdims=True)]
    )
    limits = np.concatenate(
        [rng.uniform(0.5, 1.5, 2 * dimension), rng.uniform(0.2, 1.2, len(cuts))]
    )
    if rng.random() < 0.3:
        points = brute_force_vertices(rows, limits)
        corner = points[rng.integers(len(points))]
        active = rows[abs(rows @ corner - limits) < 1e-9]
        touching = rng.random(len(active)) @ active
        rows = np.vstack([rows, touching])
        limits = np.append(limits, touching @ corner)
    return rows, limits


@cache
def case(index):
    rng = np.random.default_rng(index)
    dimension = 1 + index % 4
    flat = index // 4 % 4 == 3
    repeated = index // 8 % 2
    scaled = index // 16 % 2
    rescaled_rows = index // 32 % 2
    width = int(rng.integers(0, dimension)) if flat else dimension
    scales = 10 ** rng.uniform(-6, 6, dimension) if scaled else np.ones(dimension)
    turn = np.linalg.qr(rng.normal(size=(dimension, dimension)))[0]
    shift = rng.normal(size=dimension)
    shift = shift * rng.choice([0, 1, 10])

    def stretched(rows, limits):
        factors = 10 ** rng.uniform(-6, 6, len(rows)) if rescaled_rows else np.ones(len(rows))
        order = rng.permutation(len(rows))
        return Polytope((rows * factors[:, None] / scales)[order], (limits * factors)[order])

    inner, inner_limits = random_rows(rng, width) if width else (np.zeros((0, 0)), np.zeros(0))
    rows = np.vstack([inner @ turn[:, :width].T, turn[:, width:].T, -turn[:, width:].T])
    limits = np.concatenate([inner_limits, np.zeros(2 * (dimension - width))]) + rows @ shift
    points = brute_force_vertices(inner, inner_limits) @ turn[:, :width].T + shift
    copies = rng.integers(len(rows), size=3 * repeated)
    polytope = stretched(np.vstack([rows, rows[copies]]), np.append(limits, limits[copies]))
    other_rows, other_limits = random_rows(rng, dimension)
    other_shift = shift + rng.normal(size=dimension) * rng.choice([0, 0.5, 1])
    other_points = brute_force_vertices(other_rows, other_limits) + other_shift
    other_limits = other_limits + other_rows @ other_shift
    other = stretched(other_rows, other_limits)
    return Case(
        scales,
        rows,
        limits,
        points,
        polytope,
        other_rows,
        other_limits,
        other_points,
        other,
        flat,
        not scaled,
        rng,
    )


def share(law):
    """The cases of one law."""
    return [case(index) for index in range(law, CASES, LAWS)]


@pytest.mark.parametrize(
    "law",
    [law if law < 3 else pytest.param(law, marks=pytest.mark.slow) for law in range(LAWS)],
)
def test_support_numbers_vertices_and_kind_are_those_of_the_brute_force_vertices(law):
    for c in share(law):
        directions = c.directions()
        c.assert_support(c.polytope, directions, c.numbers(directions, c.points))
        assert c.polytope.support(directions[0]) == pytest.approx(
            c.polytope.support(directions)[0], rel=1e-14
        )
        found = c.polytope.vertices() / c.scales
        assert found.shape == c.points.shape
        nearest = abs(found[:, None] - c.points[None]).max(axis=2).min(axis=0)
        assert nearest.max() <= SET_RELATIVE * c.size
        assert (c.polytope.is_empty(), c.polytope.is_bounded(), c.polytope.is_flat()) == (
            False,
            True,
            c.flat,
        )


def test_membership_and_margin_are_those_of_the_rows():
    for c in share(0):
        inside = c.rng.dirichlet(np.ones(len(c.points)), size=20) @ c.points
        outside = (
            c.points.mean(axis=0)
            + 1.1 * (c.points - c.points.mean(axis=0))
            + (0.1 if c.flat else 0.0)
        )
        lengths = np.linalg.norm(c.polytope.normals, axis=1)
        tolerance = SET_RELATIVE * c.size * (abs(c.polytope.normals) @ c.scales / lengths).max()
        assert c.polytope.contains(inside * c.scales, tolerance).all()
        assert not c.polytope.contains(outside * c.scales).any()
        assert not c.polytope.contains(np.full(len(c.scales), np.nan))
        margins = c.polytope.margin(outside * c.scales)
        expected = [
            ((c.polytope.offsets - c.polytope.normals @ (c.scales * y)) / lengths).min()
            for y in outside
        ]
        np.testing.assert_allclose(margins, expected, atol=tolerance)


def test_containment_margin_is_the_least_distance_from_the_facets_to_the_vertices():
    for c in share(1):
        for one, two, points in (
            (c.polytope, c.other, c.other_points),
            (c.other, c.polytope, c.points),
        ):
            slacks = one.offsets - c.numbers(one.normals, points)
            lengths = np.linalg.norm(one.normals, axis=1)
            tolerance = SET_RELATIVE * c.size * (abs(one.normals) @ c.scales / lengths).max()
            assert abs(one.containment_margin(two) - (slacks / lengths).min()) <= tolerance
        hull = convex_hull([c.polytope, c.other])
        assert hull.containment_margin(c.polytope) >= -SET_RELATIVE * c.size * c.scales.max()


def test_intersection_has_the_support_of_all_rows_and_is_empty_when_they_exclude_each_other():
    empties = 0
    for c in share(2):
        rows = np.vstack([c.rows, c.other_rows])
        limits = np.append(c.limits, c.other_limits)
        room = depth(rows, limits, np.repeat([0.0, 1.0], [len(c.rows), len(c.other_rows)]))
        if abs(room) < SET_DECIDED:
            continue
        both = c.polytope.intersect(c.other)
        assert both.is_empty() == (room < 0) and both.is_flat() == (c.flat and room > 0)
        empties += room < 0
        if room < 0:
            continue
        if c.flat:
            directions = c.directions(3)
            programs = [
                linprog(-d * c.scales / abs(d * c.scales).max(), rows, limits, bounds=(None, None))
                for d in directions
            ]
            expected = -np.array([p.fun for p in programs]) * abs(directions * c.scales).max(axis=1)
        else:
            directions = c.directions()
            expected = c.numbers(directions, brute_force_vertices(rows, limits))
        c.assert_support(both, directions, expected)
    assert empties > 5


def test_support_of_a_minkowski_sum_is_the_sum_and_of_a_hull_of_the_union_the_maximum():
    for c in share(3):
        directions = c.directions()
        one = c.numbers(directions, c.points)
        two = c.numbers(directions, c.other_points)
        c.assert_support(c.polytope.minkowski_sum(c.other), directions, one + two)
        c.assert_support(convex_hull([c.polytope, c.other]), directions, np.maximum(one, two))
        cloud = np.vstack([c.points, c.other_points]) * c.scales
        corners = hull_vertices(cloud)
        reach = (directions @ cloud.T).max(axis=1)
        gap = abs((directions @ corners.T).max(axis=1) - reach)
        assert (gap <= SET_RELATIVE * c.size * (abs(directions) @ c.scales)).all()
        assert len(corners) == len(convex_hull([c.polytope, c.other]).vertices())


def test_pontryagin_difference_holds_exactly_the_points_that_carry_the_subtrahend():
    for c in share(4):
        subtrahend = c.polytope.scale(0.3)
        lengths = np.linalg.norm(c.other_rows, axis=1)
        limits = c.other_limits - 0.3 * (c.other_rows @ c.points.T).max(axis=1)
        difference = c.other.pontryagin_difference(subtrahend)
        room = depth(c.other_rows, limits, lengths)
        if abs(room) < SET_DECIDED:
            continue
        assert difference.is_empty() == (room < 0)
        candidates = (
            c.rng.normal(size=(30, len(c.scales)))
            + c.other_points.mean(axis=0)
            - 0.3 * c.points.mean(axis=0)
        )
        slack = (c.other_limits - (candidates[:, None] + 0.3 * c.points) @ c.other_rows.T).min(
            axis=(1, 2)
        )
        clear = abs(slack) > SET_DECIDED
        assert (difference.contains(candidates * c.scales) == (slack > 0))[clear].all()
        if room > 0:
            directions = c.directions()
            c.assert_support(
                difference,
                directions,
                c.numbers(directions, brute_force_vertices(c.other_rows, limits)),
            )
            tolerance = SET_RELATIVE * c.size * (abs(directions) @ c.scales)
            back = difference.minkowski_sum(subtrahend)
            assert (back.support(directions) <= c.other.support(directions) + tolerance).all()
            by_function = c.other.pontryagin_difference(subtrahend.support)
            np.testing.assert_array_equal(by_function.offsets, difference.offsets)


def test_a_set_minus_itself_is_the_origin():
    for c in share(5):
        np.testing.assert_array_equal(
            c.polytope.pontryagin_difference(c.polytope).vertices(), [0 * c.scales]
        )


def test_support_of_an_image_is_the_support_along_the_transpose():
    for c in share(1):
        count = int(c.rng.integers(1, len(c.scales) + 2))
        target = np.ones(count) if c.plain else 10 ** c.rng.uniform(-6, 6, count)
        matrix = c.rng.normal(size=(count, len(c.scales)))
        if count == len(c.scales) and c.rng.random() < 0.3:
            matrix[0] = matrix[-1] * (count > 1)
        image = c.polytope.image(target[:, None] * matrix / c.scales)
        directions = c.rng.normal(size=(20, count)) / target
        expected = (directions * target @ matrix @ c.points.T).max(axis=1)
        np.testing.assert_allclose(image.support(directions), expected, atol=SET_RELATIVE * c.size)
        assert not image.is_empty() and image.is_bounded()


def test_preimage_holds_exactly_the_points_that_map_into_the_set():
    for c in share(6):
        dimension = len(c.scales)
        count = int(c.rng.integers(1, dimension + 2))
        source = np.ones(count) if c.plain else 10 ** c.rng.uniform(-6, 6, count)
        matrix = c.rng.normal(size=(dimension, count))
        shift = c.other_points.mean(axis=0)
        preimage = c.other.preimage(c.scales[:, None] * matrix / source, c.scales * shift)
        if count > dimension:
            normals = c.rng.normal(size=(9, dimension))
            expected = (normals @ (c.other_points - shift).T).max(axis=1)
            size = c.size * np.linalg.cond(matrix)
            np.testing.assert_allclose(
                preimage.support(normals @ matrix / source), expected, atol=SET_RELATIVE * size
            )
            assert np.isinf(preimage.support(c.rng.normal(size=(20, count)) / source)).all()
            assert not preimage.is_bounded()
            continue
        points = brute_force_vertices(c.other_rows @ matrix, c.other_limits - c.other_rows @ shift)
        directions = c.rng.normal(size=(20, count)) / source
        expected = (directions * source @ points.T).max(axis=1)
        np.testing.assert_allclose(
            preimage.support(directions), expected, atol=SET_RELATIVE * (c.size + abs(points).max())
        )
        candidates = c.rng.normal(size=(30, count)) * abs(points).max()
        slack = (c.other_limits - (candidates @ matrix.T + shift) @ c.other_rows.T).min(axis=1)
        clear = abs(slack) > SET_DECIDED
        assert (preimage.contains(candidates * source) == (slack > 0))[clear].all()


def test_unit_normals_keep_the_set():
    polytope = Polytope([[2.0, 0.0], [0.0, -0.5], [-3.0, 4.0]], [1.0, 2.0, 5.0])
    unit = polytope.with_unit_normals()
    np.testing.assert_array_equal(unit.normals, [[1.0, 0.0], [0.0, -1.0], [-0.6, 0.8]])
    np.testing.assert_array_equal(unit.offsets, [0.5, 4.0, 1.0])


def test_reduce_keeps_the_set_and_no_redundant_row():
    for c in share(3):
        reduced = c.polytope.reduce()
        directions = c.directions()
        c.assert_support(reduced, directions, c.numbers(directions, c.points))
        assert reduced.is_flat() == c.flat
        rows = reduced.normals * c.scales
        lengths = np.linalg.norm(rows, axis=1)
        rows = rows / lengths[:, None]
        limits = reduced.offsets / lengths
        for i in range(len(limits)):
            # a row that may give way by one, and does not
            relaxed = linprog(-rows[i], rows, limits + np.eye(len(limits))[i], bounds=(None, None))
            assert -relaxed.fun - limits[i] > SET_DECIDED


def test_chebyshev_ball_is_a_largest_one():
    for c in share(4):
        centre, radius = c.polytope.chebyshev()
        assert (radius > 0) == (not c.flat)
        if c.flat:
            assert abs(radius) <= SET_RELATIVE
            continue
        assert c.polytope.margin(centre) == radius
        if c.plain:
            assert (
                abs(radius - depth(c.rows, c.limits, np.linalg.norm(c.rows, axis=1)))
                <= SET_CHEBYSHEV
            )
        # no point on the way to any vertex is deeper: the margin is concave, so a local maximum is
        # the largest
        ways = centre + 1e-3 * (c.points * c.scales - centre)
        assert (
            c.polytope.margin(ways) <= radius * (1 + SET_CHEBYSHEV) + SET_RELATIVE * c.scales.min()
        ).all()


def test_volume_is_that_of_the_hull_of_the_vertices_times_the_scales():
    for c in share(0):
        unit = (
            np.ptp(c.points)
            if len(c.scales) == 1
            else 0.0
            if c.flat
            else ConvexHull(c.points).volume
        )
        assert c.polytope.volume() == pytest.approx(unit * c.scales.prod(), rel=SET_RELATIVE)


@pytest.mark.parametrize("dimension", [1, 2, 3, 4])
def test_volumes_and_radii_of_simplex_box_and_cross_polytope(dimension):
    rng = np.random.default_rng(dimension)
    for _ in range(5):
        scales = 10 ** rng.uniform(-6, 6, dimension)
        matrix = rng.normal(size=(dimension, dimension))
        axes = np.diag(scales)
        box = Polytope.box(-scales, scales)
        cross = Polytope.from_vertices(np.vstack([axes, -axes]))
        simplex = Polytope.from_vertices(np.vstack([axes, 0 * scales]))
        factorial = math.factorial(dimension)
        determinant = abs(np.linalg.det(matrix))
        for polytope, volume in (
            (box, 2**dimension * scales.prod()),
            (cross, 2**dimension * scales.prod() / factorial),
            (simplex, scales.prod() / factorial),
        ):
            assert polytope.volume() == pytest.approx(volume, rel=SET_RELATIVE)
            image = polytope.image(matrix @ np.diag(1 / scales))
            assert image.volume() == pytest.approx(
                volume * determinant / scales.prod(), rel=SET_RELATIVE
            )
        inverse = np.linalg.norm(1 / scales)
        rounding = SET_RELATIVE * scales.max()
        for polytope, radius in (
            (box, scales.min()),
            (cross, 1 / inverse),
            (simplex, 1 / (inverse + (1 / scales).sum())),
        ):
            assert polytope.chebyshev()[1] == pytest.approx(radius, rel=SET_CHEBYSHEV, abs=rounding)
        assert len(cross.offsets) == 2**dimension


@pytest.mark.parametrize("dimension", [1, 2, 3, 4])
@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_boxes_that_touch_meet_in_a_flat_set_and_boxes_apart_in_none(dimension, size):
    ones = size * np.ones(dimension)
    box = Polytope.box(-ones, ones)
    facet = box.intersect(Polytope.box(np.append(-ones[1:], size), np.append(ones[1:], 3 * size)))
    corner = box.intersect(Polytope.box(ones, 3 * ones))
    apart = box.intersect(Polytope.box(1.000001 * ones, 3 * ones))
    assert (facet.is_flat(), len(facet.vertices()), facet.volume()) == (
        True,
        2 ** (dimension - 1),
        0.0,
    )
    np.testing.assert_allclose(corner.vertices(), [ones], rtol=SET_RELATIVE)
    assert apart.is_empty() and apart.vertices().shape == (0, dimension)


def test_empty_sets_stay_empty():
    everything = Polytope(np.zeros((0, 2)), np.zeros(0))
    for empty in (
        Polytope.box(np.ones(2), -np.ones(2)),
        Polytope(np.zeros((1, 2)), -np.ones(1)),
        Polytope.from_vertices(np.zeros((0, 2))),
        Polytope.box(-np.ones(2), np.ones(2)).pontryagin_difference(
            Polytope.box(-2 * np.ones(2), 2 * np.ones(2))
        ),
        Polytope.box(-np.ones(2), np.ones(2)).pontryagin_difference(everything),
    ):
        assert empty.is_empty() and empty.is_bounded() and not empty.is_flat()
        assert empty.volume() == 0 and empty.chebyshev()[1] == -np.inf
        assert (empty.support(np.eye(2)) == -np.inf).all() and empty.support(np.zeros(2)) == -np.inf
        assert everything.containment_margin(empty) == np.inf
        assert Polytope.box(np.zeros(2), np.zeros(2)).containment_margin(empty) == np.inf
        for derived in (
            empty.reduce(),
            empty.scale(0.0),
            empty.scale(2.0),
            empty.image(np.eye(2)),
            empty.image(np.ones((1, 2))),
            empty.minkowski_sum(Polytope.box(-np.ones(2), np.ones(2))),
            empty.intersect(everything),
            convex_hull([empty, empty]),
        ):
            assert derived.is_empty()
        assert empty.preimage(np.zeros((2, 3))).is_empty()


def test_cones_and_half_spaces_are_finite_along_their_normals_only():
    rng = np.random.default_rng(7)
    for index in range(40):
        dimension = 1 + index % 4
        scales = 10 ** rng.uniform(-3, 3, dimension)
        rows = rng.normal(size=(rng.integers(1, dimension + 1), dimension))
        apex = rng.normal(size=dimension) * rng.choice([0, 1, 10])
        cone = Polytope(rows / scales, rows @ apex)
        weights = rng.uniform(0.1, 1, (30, len(rows)))
        size = (1 + abs(apex).max()) * np.linalg.cond(rows)
        np.testing.assert_allclose(
            cone.support(weights @ rows / scales), weights @ rows @ apex, atol=SET_CHEBYSHEV * size
        )
        weights[:, 0] = -0.1
        assert np.isinf(cone.support(weights @ rows / scales)).all()
        assert not (cone.is_bounded() or cone.is_empty() or cone.is_flat())
        assert cone.volume() == np.inf and cone.chebyshev()[1] == np.inf
        assert len(cone.reduce().offsets) == len(rows)
        with pytest.raises(ValueError, match="unbounded"):
            cone.vertices()
        wall = cone.intersect(Polytope(-rows[:1] / scales, -rows[:1] @ apex))
        gap = cone.intersect(Polytope(-rows[:1] / scales, -rows[:1] @ apex - 1e-3))
        assert wall.is_flat() and wall.is_bounded() == (dimension == 1)
        assert wall.support(-rows[0] / scales) == pytest.approx(
            -rows[0] @ apex, abs=SET_CHEBYSHEV * size
        )
        assert gap.is_empty()


def test_linear_programs_and_generators_give_the_same_support_in_higher_dimension(monkeypatch):
    rng = np.random.default_rng(3)
    for index in range(10):
        dimension = 5 + index % 2
        bounded = index % 3 > 0
        rows = rng.normal(size=(12, dimension))
        axes = np.eye(dimension)
        rows = np.vstack([rows, axes, -axes]) if bounded else rows * np.sign(rows[:, :1])
        polytope = Polytope(rows, rng.uniform(0.3, 1, len(rows)))
        directions = rng.normal(size=(4, dimension))
        by_programs = polytope.support(directions)
        with monkeypatch.context() as patch:
            patch.setattr(frame, "HULL_DIMENSION", dimension)
            np.testing.assert_allclose(by_programs, polytope.support(directions), rtol=SET_RELATIVE)
        assert polytope.is_bounded() == bounded


def test_thin_turned_boxes_keep_their_vertices_down_to_a_relative_thickness_of_1e_8():
    rng = np.random.default_rng(5)
    for index in range(3 * 7):  # every dimension with every thickness
        dimension = 2 + index % 3
        thin = 10.0 ** -(2 + index % 7)
        turn = np.linalg.qr(rng.normal(size=(dimension, dimension)))[0]
        shift = rng.normal(size=dimension)
        half = np.append(np.ones(dimension - 1), thin)
        box = Polytope.box(-half, half).preimage(turn.T, -turn.T @ shift)
        directions = rng.normal(size=(20, dimension))
        expected = abs(directions @ turn) @ half + directions @ shift
        np.testing.assert_allclose(box.support(directions), expected, atol=SET_RELATIVE * 10)
        assert len(box.vertices()) == 2**dimension and not box.is_flat()


def test_unbounded_boxes_are_infinite_along_their_open_sides_only():
    rng = np.random.default_rng(11)
    for index in range(100):
        dimension = 1 + index % 4
        scales = 10 ** rng.uniform(-6, 6, dimension)
        shift = rng.normal(size=dimension) * rng.choice([0, 1, 10])
        sides = rng.uniform(0.1, 2, (2, dimension))
        sides[rng.random(sides.shape) < 0.3] = np.inf
        box = Polytope.box((shift - sides[0]) * scales, (shift + sides[1]) * scales)
        sparse = rng.normal(size=(10, dimension)) * (rng.random((10, dimension)) < 0.5)
        directions = np.vstack([np.eye(dimension), -np.eye(dimension), sparse])
        pieces = [
            np.where(part > 0, np.where(part > 0, part, 1) * side, 0)
            for part, side in ((directions * scales, sides[1]), (-directions * scales, sides[0]))
        ]
        expected = (pieces[0] + pieces[1]).sum(axis=1) + directions * scales @ shift
        numbers = box.support(directions)
        finite = np.isfinite(expected)
        np.testing.assert_array_equal(np.isfinite(numbers), finite)
        error = abs(numbers[finite] - expected[finite])
        assert (error <= SET_RELATIVE * 100 * (abs(directions[finite]) @ scales)).all()
        assert box.is_bounded() == np.isfinite(sides).all()


def test_near_duplicate_points_and_rows_change_the_set_no_more_than_they_differ():
    rng = np.random.default_rng(9)
    for index in range(3 * 10):  # every dimension with every distance
        dimension = 2 + index % 3
        apart = 10.0 ** -(7 + index % 10)
        rows = rng.normal(size=(15, dimension))
        rows = np.vstack(
            [
                rows / np.linalg.norm(rows, axis=1, keepdims=True),
                np.eye(dimension),
                -np.eye(dimension),
            ]
        )
        near = np.vstack([rows + apart * rng.normal(size=rows.shape) for _ in range(5)])
        directions = rng.normal(size=(20, dimension))
        tolerance = 100 * (apart + SET_NEAR_DUPLICATE)
        np.testing.assert_allclose(
            Polytope.from_vertices(near).support(directions),
            (directions @ rows.T).max(axis=1),
            atol=tolerance,
        )
        noisy = Polytope(near, np.ones(len(near)))
        limits = np.ones(len(rows))
        np.testing.assert_allclose(
            noisy.support(directions), Polytope(rows, limits).support(directions), atol=tolerance
        )
        np.testing.assert_allclose(
            noisy.reduce().support(directions),
            noisy.support(directions),
            atol=100 * SET_NEAR_DUPLICATE,
        )


def test_rows_that_touch_in_a_face_of_lower_dimension_are_redundant():
    rng = np.random.default_rng(13)
    for index in range(40):
        dimension = 2 + index % 3
        half = rng.uniform(0.5, 2, dimension)
        shift = 1000 * rng.normal(size=dimension)
        box = Polytope.box(shift - half, shift + half)
        signs = rng.choice([-1.0, 1.0], size=(10, dimension)) * rng.uniform(0, 1, (10, dimension))
        signs[np.arange(10), rng.integers(dimension, size=10)] *= rng.choice([0.0, 1.0], size=10)
        touching = Polytope(signs, signs @ shift + abs(signs) @ half)
        proper = (abs(signs) > 0).sum(axis=1) > 1
        both = box.intersect(Polytope(touching.normals[proper], touching.offsets[proper]))
        assert len(both.reduce().offsets) == 2 * dimension


def test_an_invertible_image_of_an_unbounded_set_needs_no_vertices():
    rng = np.random.default_rng(15)
    cone = Polytope(-np.eye(3), np.zeros(3))
    matrix = rng.normal(size=(3, 3))
    inside = rng.uniform(0, 1, size=(20, 3))
    image = cone.image(matrix)
    assert image.contains(inside @ matrix.T, SET_RELATIVE).all()
    assert not image.contains(-inside @ matrix.T).any()
    with pytest.raises(ValueError, match="unbounded"):
        cone.image(matrix[:2])


def test_points_and_segments_are_sets():
    point = Polytope.from_vertices(np.array([[1.0, -2.0, 3.0]]))
    segment = Polytope.from_vertices(
        np.array([[1.0, -2.0, 3.0], [2.0, 0.0, 3.0], [1.5, -1.0, 3.0]])
    )
    assert point.is_flat() and segment.is_flat() and segment.volume() == 0
    np.testing.assert_allclose(point.vertices(), [[1, -2, 3]], rtol=SET_RELATIVE)
    np.testing.assert_allclose(
        np.sort(segment.vertices(), axis=0), [[1, -2, 3], [2, 0, 3]], atol=SET_RELATIVE
    )
    assert len(hull_vertices(np.array([[1.0], [3.0], [2.0], [3.0]]))) == 2
    np.testing.assert_array_equal(
        Polytope.box(-1.0 * np.ones(2), np.ones(2)).scale(0.0).vertices(), [[0, 0]]
    )


def test_rows_that_do_not_bind_are_dropped():
    rows = np.array([[1.0, 0.0], [0.0, 0.0], [0.0, 1.0]])
    assert len(Polytope(rows, np.array([1.0, 0.0, np.inf])).offsets) == 1
    assert Polytope(rows, np.array([1.0, -1e-300, 1.0])).is_empty()
    everything = Polytope.box(-np.inf * np.ones(2), np.inf * np.ones(2))
    assert everything.support(np.zeros(2)) == 0 and everything.support(np.ones(2)) == np.inf
    assert everything.contains(np.zeros(2)) and everything.margin(np.zeros(2)) == np.inf
    assert len(everything.reduce().offsets) == 0 and everything.chebyshev()[1] == np.inf


@pytest.mark.parametrize(
    ("call", "names"),
    [
        (lambda box: Polytope(np.ones(2), np.ones(2)), "normals"),
        (lambda box: Polytope(np.ones((1, 2)), np.ones(2)), "offsets"),
        (lambda box: Polytope(np.full((1, 2), np.nan), np.ones(1)), "normals"),
        (lambda box: Polytope(np.ones((1, 2)), np.full(1, np.nan)), "offsets"),
        (lambda box: Polytope(np.ones((1, 2)), np.full(1, -np.inf)), "offsets"),
        (lambda box: Polytope.from_vertices(np.array([[np.inf, 0.0]])), "points"),
        (lambda box: hull_vertices(np.ones(3)), "points"),
        (lambda box: box.support(np.ones(3)), "directions"),
        (lambda box: box.support(np.full(2, np.nan)), "directions"),
        (lambda box: box.contains(np.ones(3)), "points"),
        (lambda box: box.image(np.ones((2, 3))), "matrix"),
        (lambda box: box.preimage(np.ones((3, 2))), "matrix"),
        (lambda box: box.scale(-1.0), "factor"),
        (lambda box: box.intersect(Polytope.box(-np.ones(3), np.ones(3))), "normals"),
        (lambda box: box.containment_margin(Polytope.box(-np.ones(3), np.ones(3))), "normals"),
        (lambda box: convex_hull([]), "polytopes"),
        (lambda box: convex_hull([box, Polytope.box(-np.ones(3), np.ones(3))]), "polytopes"),
    ],
)
def test_bad_input_is_refused_in_one_line_that_names_it(call, names):
    with pytest.raises(ValueError, match=names) as refusal:
        call(Polytope.box(-np.ones(2), np.ones(2)))
    assert "\n" not in str(refusal.value)


def test_arrays_of_a_set_cannot_be_changed():
    box = Polytope.box(-np.ones(2), np.ones(2))
    with pytest.raises(ValueError, match="read-only"):
        box.offsets[0] = 2.0
