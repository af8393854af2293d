"""Laws of boxes: they hold what they are made from, no smaller one does, and kinds contain each
other."""

import numpy as np
import pytest

from jaxtube.identification.box import SIDES, Box, blow_up, enclose, make_alike

DRAW = np.random.default_rng(4)
SLIPS = DRAW.normal([0.1, 0.05], [0.02, 0.04], (40, 2))
SIDESLIPS = DRAW.normal(0.0, 0.02, 40)
SHAPE = Box((0.08, 0.12), (0.0, 0.1), 0.03)


@pytest.mark.parametrize(
    "box",
    [
        enclose(SLIPS, SIDESLIPS),
        make_alike(enclose(SLIPS, SIDESLIPS)),
        blow_up(SHAPE, SLIPS, SIDESLIPS),
    ],
)
def test_a_box_holds_what_it_is_made_from(box):
    assert box.widen(1e-12).holds(SLIPS, SIDESLIPS).all()


def test_no_side_of_the_smallest_box_can_move_in():
    box = enclose(SLIPS, SIDESLIPS)
    for right, left, sideslip in (
        ((box.right[0] + 1e-9, box.right[1]), box.left, box.sideslip),
        ((box.right[0], box.right[1] - 1e-9), box.left, box.sideslip),
        (box.right, (box.left[0] + 1e-9, box.left[1]), box.sideslip),
        (box.right, (box.left[0], box.left[1] - 1e-9), box.sideslip),
        (box.right, box.left, box.sideslip - 1e-9),
    ):
        assert not Box(right, left, sideslip).holds(SLIPS, SIDESLIPS).all()


def test_a_box_that_is_blown_up_keeps_its_middle_and_its_shape():
    box = blow_up(SHAPE, SLIPS, SIDESLIPS)
    assert box.middle == pytest.approx(SHAPE.middle)
    factor = box.sideslip / SHAPE.sideslip
    assert factor >= 1.0
    assert np.diff(box.right)[0] == pytest.approx(factor * np.diff(SHAPE.right)[0])
    assert np.diff(box.left)[0] == pytest.approx(factor * np.diff(SHAPE.left)[0])
    assert not blow_up(SHAPE, SLIPS, SIDESLIPS).widen(-1e-6).holds(SLIPS, SIDESLIPS).all()


def test_an_alike_box_has_one_interval():
    box = make_alike(enclose(SLIPS, SIDESLIPS))
    assert box.right == box.left
    assert box.right == (SLIPS.min(), SLIPS.max())


def test_a_margin_widens_slips_alone():
    box = enclose(SLIPS, SIDESLIPS)
    wide = box.widen(0.01)
    assert np.diff(wide.right) == pytest.approx(np.diff(box.right) + 0.02)
    assert wide.sideslip == box.sideslip


def test_nan_lies_in_no_box():
    assert not SHAPE.holds(np.array([[np.nan, 0.05]]), np.zeros(1)).any()


def test_sides_are_those_that_a_sample_fixes():
    assert SIDES == {"each": 5, "alike": 3, "scaled": 1}
