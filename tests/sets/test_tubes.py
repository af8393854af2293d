"""Laws of the tubes: they hold every deviation, no more than each promises, and the shifted plan
stays admissible."""

import functools
import itertools

import numpy as np
import pytest
from paper_problem import GRIP, PERIOD, TRACK, U, W, corners, tube_gains, tube_loop, tube_loops
from tolerances import TUBE_ROUNDING

from sets.polytope import Polytope
from sets.tubes import (
    Section,
    hull_tube,
    input_support,
    paper_tube,
    propagate,
    sequence_support,
    sequence_tube,
    summed_tube,
)

TUBE_HALF_WIDTH = 0.5e-6
"""In m; the reference half widths are printed to six decimals."""
TUBE_HALF_WIDTH_DEG = 0.5e-5
"""And to five in degrees."""
TUBE_VOLUME = 0.5e-9
"""The reference volumes are printed to five digits."""
TUBE_GAIN_REACH = 0.5e-4
"""In m/s; printed to four decimals."""
LONG_TUBE = 0.5e-3
"""In m; printed to three decimals."""

N = 5
SLOPES = [
    np.array([[0, 0, 0], [-PERIOD * GRIP / TRACK, 0, PERIOD / 2], [0, 0, 0]]),
    np.array([[0, 0, 0], [PERIOD * GRIP / TRACK, 0, PERIOD / 2], [0, 0, 0]]),
]
RANGES = [(-0.65, 0.65), (-0.65, 0.65)]
NOMINAL = tube_loop(0.85, 0.85)
LOOPS = tube_loops()
FLAT = Polytope.box(
    np.array([-0.005, 0.0, -0.003]), np.array([0.004, 0.0, 0.003])
)  # flat and off the origin's centre


def paper(disturbance: Polytope = W, horizon: int = N) -> list[Section]:
    return paper_tube(NOMINAL, SLOPES, RANGES, disturbance, horizon)


RANDOM = np.random.default_rng(7).uniform(-0.6, 0.6, size=(3, 3, 3))

# the paper's loops make `hull` and `summed` equal up to rounding; the random ones keep them apart
each_system = pytest.mark.parametrize(
    ("loops", "disturbance"),
    [(LOOPS, W), (LOOPS, FLAT), (RANDOM, W)],
    ids=["box", "flat", "random"],
)

FAMILIES = {
    "paper": paper,
    "hull": functools.partial(hull_tube, LOOPS),
    "summed": functools.partial(summed_tube, LOOPS),
}
each_family = pytest.mark.parametrize("family", FAMILIES)


def directions(count: int = 1000) -> np.ndarray:
    """Random directions, and the facet normals that a design uses: of E, of U through the gains, of
    a tube section."""
    drawn = np.random.default_rng(0).normal(size=(count, 3)) * [1.0, 1.0, 0.3]
    axes = np.vstack([np.eye(3), -np.eye(3)])
    inputs = np.concatenate([U.normals @ gain for gain in tube_gains()])
    facets = hull_tube(LOOPS, W, N)[N].polytope().normals
    return np.concatenate([axes, inputs, facets, drawn])


def width(disturbance: Polytope, rows: np.ndarray) -> np.ndarray:
    return np.max(rows @ disturbance.vertices().T, axis=1)


def products(loops: np.ndarray, count: int):
    """Yield every product of `count` loops."""
    for chosen in itertools.product(loops, repeat=count):
        yield functools.reduce(lambda product, loop: loop @ product, chosen, np.eye(3))


def random_schedules(count: int, horizon: int = N) -> np.ndarray:
    """Draw schedules, half of them from the corners of the box."""
    rng = np.random.default_rng(1)
    inside = rng.uniform(0.2, 1.5, size=(count, horizon, 2))
    extreme = rng.choice([0.2, 1.5], size=(count, horizon, 2))
    return np.where(rng.random((count, 1, 1)) < 0.5, inside, extreme)


def along(schedule: np.ndarray) -> np.ndarray:
    return np.array([tube_loop(*speeds) for speeds in schedule])


def test_half_widths_equal_the_reference_numbers():
    expected = {"paper": [0.020675, 0.038934, 1.05251], "hull": [0.020675, 0.036638, 1.04106]}
    for family, widths in expected.items():
        for sign in (1, -1):
            longitudinal, lateral, heading = FAMILIES[family](W, N)[N].support(sign * np.eye(3))
            np.testing.assert_allclose(
                [longitudinal, lateral], widths[:2], rtol=0, atol=TUBE_HALF_WIDTH
            )
            assert np.rad2deg(heading) == pytest.approx(widths[2], rel=0, abs=TUBE_HALF_WIDTH_DEG)


def test_volumes_equal_the_reference_numbers():
    for family, volume in {"paper": 9.8017e-05, "hull": 9.1322e-05}.items():
        assert FAMILIES[family](W, N)[N].polytope().volume() == pytest.approx(
            volume, abs=TUBE_VOLUME
        )


def test_reach_of_the_inputs_equals_the_reference_numbers():
    reach = [input_support(section, tube_gains(), U.normals) for section in paper()[1:]]
    expected = np.array([0.0175, 0.0378, 0.0606, 0.0856, 0.1124])
    np.testing.assert_allclose(reach, np.tile(expected[:, None], 4), rtol=0, atol=TUBE_GAIN_REACH)


def test_lateral_reach_of_many_steps_passes_the_error_limit():
    lateral = np.array([[0.0, 1.0, 0.0]])
    sections = hull_tube(LOOPS, W, 60)
    assert sections[40].support(lateral)[0] == pytest.approx(0.300, abs=LONG_TUBE)
    assert sections[60].support(lateral)[0] == pytest.approx(0.327, abs=LONG_TUBE)


@each_family
@pytest.mark.parametrize("horizon", [0, 1, 2, N])
def test_a_tube_starts_at_the_origin_then_the_disturbance(family, horizon):
    sections = FAMILIES[family](W, horizon)
    assert len(sections) == horizon + 1
    assert not sections[0].support(directions(10)).any()
    for section in sections[1:2]:
        np.testing.assert_allclose(
            section.support(directions(10)), width(W, directions(10)), atol=TUBE_ROUNDING
        )


def test_each_tube_lies_inside_the_next_wider_one():
    rows = directions()
    hull = FAMILIES["hull"](W, N)
    summed = FAMILIES["summed"](W, N)
    wide = FAMILIES["paper"](W, N)
    for j in range(N + 1):
        assert (hull[j].support(rows) <= summed[j].support(rows) + TUBE_ROUNDING).all()
        assert (summed[j].support(rows) <= wide[j].support(rows) + TUBE_ROUNDING).all()
    assert summed[N].polytope().volume() < 0.95 * wide[N].polytope().volume()


def test_the_tube_of_a_known_schedule_lies_inside_those_of_every_schedule():
    rows = directions()
    hull = hull_tube(LOOPS, W, N)
    for schedule in random_schedules(50):
        for section, wider in zip(sequence_tube(along(schedule), W), hull, strict=True):
            assert (section.support(rows) <= wider.support(rows) + TUBE_ROUNDING).all()


@each_system
def test_hull_is_the_greatest_reach_over_all_schedules(loops, disturbance):
    rows = directions(40)
    for j, section in enumerate(hull_tube(loops, disturbance, N)[1:], start=1):
        reach = []
        for schedule in itertools.product(loops, repeat=j - 1):
            transported = rows
            total = width(disturbance, rows)
            for loop in schedule:
                transported = transported @ loop
                total = total + width(disturbance, transported)
            reach.append(total)
        np.testing.assert_allclose(
            section.support(rows), np.max(reach, axis=0), rtol=0, atol=TUBE_ROUNDING
        )


@each_system
def test_summed_is_the_sum_of_the_hulls_of_all_products(loops, disturbance):
    rows = directions(40)
    total = np.zeros(len(rows))
    clouds = propagate(loops, disturbance, N - 1)
    for j, section in enumerate(summed_tube(loops, disturbance, N)):
        np.testing.assert_allclose(section.support(rows), total, rtol=0, atol=TUBE_ROUNDING)
        if j < N:
            largest = np.max(
                [width(disturbance, rows @ product) for product in products(loops, j)], axis=0
            )
            np.testing.assert_allclose(clouds[j].support(rows), largest, rtol=0, atol=TUBE_ROUNDING)
            total = total + largest


@pytest.mark.parametrize("disturbance", [W, FLAT], ids=["box", "flat"])
def test_paper_follows_its_recursion_in_support_numbers(disturbance):
    def support(j: int, row: np.ndarray) -> float:
        if j == 0:
            return 0.0
        total = width(disturbance, row[None])[0] + support(j - 1, row @ NOMINAL)
        for slope, values in zip(SLOPES, RANGES, strict=True):
            total += max(support(j - 1, value * row @ slope) for value in values)
        return total

    rows = directions(3)
    for j, section in enumerate(paper(disturbance)):
        expected = [support(j, row) for row in rows]
        np.testing.assert_allclose(section.support(rows), expected, rtol=0, atol=TUBE_ROUNDING)


def test_paper_treats_each_parameter_over_its_own_range():
    uneven = [(-0.1, 0.65), (-0.65, 0.3)]
    rows = directions(40)
    two = paper_tube(NOMINAL, SLOPES, uneven, FLAT, 2)[2].support(rows)
    expected = width(FLAT, rows) + width(FLAT, rows @ NOMINAL)
    for slope, values in zip(SLOPES, uneven, strict=True):
        expected = expected + np.max(
            [width(FLAT, value * rows @ slope) for value in values], axis=0
        )
    np.testing.assert_allclose(two, expected, rtol=0, atol=TUBE_ROUNDING)


def simulated(loops: np.ndarray, draws: np.ndarray) -> np.ndarray:
    """Return the deviations of steps 1..N, axes (run, step, coordinate), from 0 under loops and
    disturbances."""
    deviation = np.zeros((len(draws), 3))
    path = []
    for loop, disturbance in zip(np.moveaxis(loops, 1, 0), np.moveaxis(draws, 1, 0), strict=True):
        deviation = np.einsum("rij,rj->ri", loop, deviation) + disturbance
        path.append(deviation)
    return np.stack(path, axis=1)


@each_family
def test_sampled_deviations_stay_in_every_section(family):
    schedules = random_schedules(2000)
    loops = np.array([along(schedule) for schedule in schedules])
    draws = np.random.default_rng(2).choice(W.vertices(), size=(len(loops), N))
    paths = simulated(loops, draws)
    for j, section in enumerate(FAMILIES[family](W, N)[1:]):
        assert section.polytope().contains(paths[:, j], tolerance=TUBE_ROUNDING).all()


def test_sampled_deviations_stay_in_the_tube_of_their_schedule():
    rng = np.random.default_rng(3)
    for schedule in random_schedules(10):
        draws = rng.choice(W.vertices(), size=(500, N))
        paths = simulated(np.broadcast_to(along(schedule), (500, N, 3, 3)), draws)
        for j, section in enumerate(sequence_tube(along(schedule), W)[1:]):
            assert section.polytope().contains(paths[:, j], tolerance=TUBE_ROUNDING).all()


def test_the_worst_disturbance_reaches_every_facet_of_the_tube_of_a_schedule():
    loops = along(random_schedules(1)[0])
    section = sequence_tube(loops, W)[N].polytope()
    for normal, offset in zip(section.normals, section.offsets, strict=True):
        row = normal
        worst = []
        for loop in loops[::-1]:
            worst.append(W.vertices()[np.argmax(W.vertices() @ row)])
            row = row @ loop
        reached = simulated(loops[None], np.array(worst[::-1])[None])[0, -1]
        assert normal @ reached == pytest.approx(offset, rel=0, abs=TUBE_ROUNDING)


@pytest.mark.parametrize("family", ["summed", "paper"])
def test_shifted_plan_inclusion_holds_for_every_product(family):
    rows = directions(200)
    sections = FAMILIES[family](W, N)
    for j in range(N):
        room = sections[j + 1].support(rows) - sections[j].support(rows)
        for product in products(LOOPS, j):
            assert (width(W, rows @ product) <= room + TUBE_ROUNDING).all()


def test_shifted_plan_inclusion_holds_with_equality_along_a_schedule():
    rows = directions(200)
    loops = along(random_schedules(1, N + 1)[0])
    now = sequence_tube(loops[:N], W)
    later = sequence_tube(loops[1:], W)
    product = np.eye(3)
    for j in range(N):
        if j:
            product = loops[j] @ product
        shifted = later[j].support(rows) + width(W, rows @ product)
        np.testing.assert_allclose(now[j + 1].support(rows), shifted, rtol=0, atol=TUBE_ROUNDING)


def test_hull_can_lack_the_shifted_plan_inclusion_and_summed_cannot():
    loops = np.array([[[0.0, 2.0], [0.0, 0.0]], [[0.9, 0.0], [0.0, 0.0]]])
    unit = Polytope.box(-np.ones(2), np.ones(2))
    row = np.array([[1.0, 0.0]])
    needed = (
        hull_tube(loops, unit, 2)[2].support(row)[0] + width(unit, row @ loops[1] @ loops[0])[0]
    )
    assert needed == pytest.approx(4.8)
    assert hull_tube(loops, unit, 3)[3].support(row)[0] == pytest.approx(3.7)
    assert summed_tube(loops, unit, 3)[3].support(row)[0] >= needed - TUBE_ROUNDING


def test_support_numbers_of_many_windows_equal_those_of_their_sections():
    loops = np.array([along(schedule) for schedule in random_schedules(6)])
    rows = np.random.default_rng(4).normal(size=(6, 20, 3))
    for j in range(N + 1):
        expected = [
            sequence_tube(window, W)[j].support(row)
            for window, row in zip(loops, rows, strict=True)
        ]
        np.testing.assert_allclose(
            sequence_support(loops, W, rows, j), expected, rtol=0, atol=TUBE_ROUNDING
        )


def test_support_along_inputs_is_the_greatest_over_gains_and_vertices():
    section = hull_tube(LOOPS, FLAT, 3)[3]
    gains = tube_gains()
    values = [U.normals @ gain @ section.vertices().T for gain in gains]
    expected = np.max(values, axis=(0, 2))
    np.testing.assert_allclose(
        input_support(section, gains, U.normals), expected, rtol=0, atol=TUBE_ROUNDING
    )


@each_family
def test_vertices_and_polytope_carry_the_support_of_the_section(family):
    rows = directions(50)
    section = FAMILIES[family](W, 4)[4]
    np.testing.assert_allclose(
        (rows @ section.vertices().T).max(axis=1), section.support(rows), atol=TUBE_ROUNDING
    )
    np.testing.assert_allclose(
        section.polytope().support(rows), section.support(rows), atol=TUBE_ROUNDING
    )


def test_image_and_sum_act_on_support_numbers():
    first, second = hull_tube(LOOPS, W, 3)[2:4]
    matrix = np.random.default_rng(5).normal(size=(2, 3))
    rows = np.random.default_rng(6).normal(size=(20, 2))
    np.testing.assert_allclose(
        first.image(matrix).support(rows), first.support(rows @ matrix), atol=TUBE_ROUNDING
    )
    total = first.support(directions(20)) + second.support(directions(20))
    np.testing.assert_allclose((first + second).support(directions(20)), total, atol=TUBE_ROUNDING)


def test_no_disturbance_leaves_the_origin():
    still = Polytope.box(np.zeros(3), np.zeros(3))
    for tube in (*(make(still, N) for make in FAMILIES.values()), sequence_tube(LOOPS, still)):
        assert not any(section.support(directions(10)).any() for section in tube)


def test_corners_are_the_vertices_of_the_affine_loop():
    loops = [
        NOMINAL + (right - 0.85) * SLOPES[0] + (left - 0.85) * SLOPES[1]
        for right, left in corners()
    ]
    np.testing.assert_allclose(LOOPS, loops, rtol=0, atol=TUBE_ROUNDING)
