"""What is exported is proved as it is written: constants that are off by more than the room of the
design are not, and no sampled plan misses a row by more than what is proved."""

import dataclasses

import numpy as np
import pytest

from jaxtube.exporting.constants import DOUBLE, SINGLE, Constants, gather_constants
from jaxtube.exporting.proof import prove, prove_doubles, prove_floats
from jaxtube.exporting.rows import KINDS
from jaxtube.synthesis.tightening import find_back_off


@pytest.fixture(scope="module")
def doubles(certified):
    return prove_doubles(certified)


def change(constants, name: str, by: float):
    """Return constants with one number of one array changed, relative to its size."""
    array = getattr(constants, name).copy()
    finite = np.where(np.isfinite(array), np.abs(array), 0.0)
    place = np.unravel_index(int(np.argmax(finite)), array.shape)
    array[place] *= 1 + by
    return dataclasses.replace(constants, **{name: array})


def test_doubles_keep_the_guarantee(doubles):
    assert doubles.holds
    assert doubles.is_exact
    assert all(0 <= missed < 1e-7 for missed in doubles.missed.values())


def test_floats_keep_it_once_constraints_are_drawn_in(certified):
    floats = prove_floats(certified)
    assert floats is not None
    assert floats.holds
    assert floats.design.certificate.holds_for_robot
    assert np.all(floats.design.bounds.errors <= certified.bounds.errors)
    assert floats.constants.rows.dtype == np.float32


@pytest.mark.parametrize(
    "name", [field.name for field in dataclasses.fields(Constants) if field.name != "precision"]
)
def test_every_number_of_the_controller_is_compared(certified, doubles, name):
    value = getattr(doubles.constants, name)
    changed = {
        str: lambda value: "paper",
        bool: lambda value: not value,
        int: lambda value: value + 1,
        float: lambda value: value + 0.1,
        np.ndarray: lambda value: value + 1,
    }[type(value)](value)
    constants = dataclasses.replace(doubles.constants, **{name: changed})
    assert not prove(certified, constants, find_back_off(certified.problem)).holds


def test_bounds_that_give_in_one_stage_and_take_in_the_next_add_up(certified, doubles):
    # A plan that is accepted with the one is shifted into the other.
    share = find_back_off(certified.problem)
    room = share * certified.problem.input_rows.offsets.min()
    horizon = certified.problem.horizon
    pairs = len(certified.problem.input_rows.offsets) // 2
    upper = doubles.constants.upper.copy()
    norms = certified.tube_qps.factors.row_norms
    last = 3 * (horizon - 1) + pairs * (horizon - 1)
    upper[:, last] += 0.6 * room / norms[:, last]
    one = dataclasses.replace(doubles.constants, upper=upper.copy())
    assert prove(certified, one, share).holds
    upper[:, last - pairs] -= 0.6 * room / norms[:, last - pairs]
    both = dataclasses.replace(doubles.constants, upper=upper)
    assert not prove(certified, both, share).holds


def test_terminal_rows_that_are_missed_enlarge_what_is_asked_of_the_terminal_set(
    certified, doubles
):
    by = 1e-3
    facets = len(certified.bounds.terminal_normals)
    norms = certified.tube_qps.factors.row_norms[:, -facets:]
    upper = doubles.constants.upper.copy()
    upper[:, -facets:] += by / norms
    changed = dataclasses.replace(doubles.constants, upper=upper)
    margins = prove(certified, changed, find_back_off(certified.problem)).margins
    share = by / certified.bounds.terminal.min()
    for kind in ("errors", "inputs"):
        lost = doubles.margins[f"{kind} returns"] - margins[f"{kind} returns"]
        largest = np.max(getattr(certified.bounds, kind))
        np.testing.assert_allclose(lost, share * largest, rtol=1e-6)


def test_a_bound_where_the_design_has_none_is_not_proved(certified, doubles):
    lower = doubles.constants.lower.copy()
    assert np.any(np.isinf(lower))
    lower[np.isinf(lower)] = 1000.0
    changed = dataclasses.replace(doubles.constants, lower=lower)
    assert not prove(certified, changed, find_back_off(certified.problem)).holds


def test_floats_do_not_keep_it_with_the_constraints_of_doubles(certified):
    constants = gather_constants(certified, SINGLE)
    assert not prove(certified, constants, find_back_off(certified.problem)).holds


@pytest.mark.parametrize("name", ["rows", "row_errors", "upper", "lower"])
@pytest.mark.parametrize("by", [1e-5, -1e-5])
def test_numbers_that_are_off_are_not_proved(certified, doubles, name, by):
    changed = change(doubles.constants, name, by)
    assert not prove(certified, changed, find_back_off(certified.problem)).holds


@pytest.mark.parametrize("name", ["rows", "upper"])
def test_last_bits_that_are_off_are_within_the_room(certified, doubles, name):
    changed = change(doubles.constants, name, 1e-15)
    assert prove(certified, changed, find_back_off(certified.problem)).holds


def test_windows_that_changed_places_are_not_proved(certified, doubles):
    constants = doubles.constants
    turned = {name: np.roll(getattr(constants, name), 1, axis=0) for name in ("rows", "row_errors")}
    changed = dataclasses.replace(constants, **turned)
    assert not prove(certified, changed, find_back_off(certified.problem)).holds


@pytest.mark.parametrize("precision", [DOUBLE, SINGLE])
def test_no_sampled_plan_misses_a_row_by_more_than_is_proved(certified, precision):
    constants = gather_constants(certified, precision)
    proof = prove(certified, constants, find_back_off(certified.problem))
    problem = certified.problem
    qps = certified.tube_qps
    generator = np.random.default_rng(7)
    largest = np.abs(problem.input_set.vertices()).max(axis=0)
    for window in range(len(constants.rows)):
        errors = (generator.uniform(-2, 2, (200, 3)) * constants.caps).astype(precision.name)
        inputs = generator.uniform(-2, 2, (200, problem.horizon, 2)) * largest
        plans = inputs.reshape(200, -1).astype(precision.name)
        # As the controller computes it, in its own precision.
        ours = errors @ constants.row_errors[window].T + plans @ constants.rows[window].T
        rows = qps.factors.rows[window] * qps.factors.row_norms[window][:, None]
        exact = errors.astype(float) @ qps.row_errors[window].T + plans.astype(float) @ rows.T
        count = rows.shape[0]
        norms = qps.factors.row_norms[window]
        differs = np.abs(ours[:, :count].astype(float) * norms - exact).max(axis=0)
        # The tolerance, which both sides of `missed` leave out here, is the larger part of it.
        rest = max(proof.missed[kind] for kind in KINDS) - norms * precision.tolerance
        assert np.all(differs <= rest)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "floats_too"),
    [("paper", None), ("robust", None), ("tuned", False), ("husky", True), ("certified_30", None)],
)
def test_designs_of_all_kinds_are_proved(name, floats_too):
    import jaxtube as jt

    design = jt.design(jt.load(name))
    proof = prove_doubles(design)
    assert proof.holds
    assert proof.is_exact == design.certificate.holds_for_robot
    if floats_too is not None:
        assert (prove_floats(design) is not None) == floats_too


def test_what_is_not_certified_is_not_called_so(tmp_path):
    import jaxtube as jt

    design = jt.design(jt.load("paper", ["reference.duration_s=1"]))
    exported = jt.export(design, tmp_path / "controller", "paper")
    assert "NOT CERTIFIED" in repr(exported)
    assert "certified again" not in repr(exported)
    assert "not certified; its rows are those of the design to" in repr(exported)
    readme = (exported.folder / "README.md").read_text()
    assert "Nothing: the design is not certified for the robot" in readme
    assert "certified again" not in readme
    header = (exported.folder / "c" / "constants.h").read_text()
    assert "#define JAXTUBE_IS_CERTIFIED 0" in header
