"""The QPs that run are those of the sets that are certified: any other ones fail the condition."""

import dataclasses

import numpy as np
import pytest
from oracles import SEQUENCE

from jaxtube.synthesis import condense
from jaxtube.synthesis.certificate.program import check_program
from jaxtube.synthesis.parts import Design


@dataclasses.dataclass
class Fixed:
    """Condensed QPs that are given."""

    with_tube: object


@pytest.fixture(scope="module")
def following(uncertified) -> Design:
    """A design whose windows differ along the path."""
    return uncertified("paper", *SEQUENCE)


def holds(design: Design, **changed) -> bool:
    """Whether the condition holds with parts of the QPs replaced."""
    window = design.tube_qps._replace(**changed)
    return check_program(dataclasses.replace(design, condensed=Fixed(window))).holds


@pytest.mark.parametrize("sound", ["robust_design", "following"])
def test_qps_made_by_the_design_are_those_of_its_sets(sound, request):
    design = request.getfixturevalue(sound)
    assert check_program(design).holds
    assert holds(design)


@pytest.mark.parametrize("sound", ["robust_design", "following"])
@pytest.mark.parametrize(
    "part", ["row_errors", "lower", "upper", "free_rows", "tube_gain", "transition", "input_matrix"]
)
def test_one_number_off_by_a_millionth_is_seen(sound, part, request):
    design = request.getfixturevalue(sound)
    numbers = np.array(getattr(design.tube_qps, part))
    place = np.unravel_index(np.argmax(np.isfinite(numbers)), numbers.shape)
    numbers[place] += 1e-6
    assert not holds(design, **{part: numbers})


def test_rows_on_the_inputs_are_compared(robust_design):
    factors = robust_design.tube_qps.factors
    assert not holds(robust_design, factors=factors._replace(row_norms=1.001 * factors.row_norms))


def test_mpc_without_a_tube_is_not_the_one_that_is_certified(following):
    untightened = dataclasses.replace(following, condensed=Fixed(following.plain_qps))
    condition = check_program(untightened)
    assert not condition.holds
    assert "bounds" in condition.sentence


def test_plans_for_another_stretch_of_the_path_are_seen(following):
    windows = dataclasses.replace(following.windows, index=np.roll(following.windows.index, 40))
    condition = check_program(dataclasses.replace(following, windows=windows))
    assert not condition.holds
    assert "wheel speeds ahead" in condition.sentence


def test_a_model_of_another_period_is_seen(robust_design):
    problem = robust_design.problem
    model = dataclasses.replace(problem.model, dt=1.02 * problem.model.dt)
    slower = dataclasses.replace(robust_design, problem=dataclasses.replace(problem, model=model))
    assert not check_program(slower).holds


def test_terminal_rows_of_another_set_are_seen(following):
    bounds = dataclasses.replace(following.bounds, terminal=1.001 * following.bounds.terminal)
    parts = (following.problem, following.windows, following.terminal, following.cost.cost, bounds)
    assert not holds(following, **condense.condense(*parts)._asdict())
