"""Laws of a design's certificate: sound designs pass, and one thing broken fails exactly the
conditions it breaks."""

import dataclasses
import functools
import importlib

import numpy as np
import pytest
from oracles import SEQUENCE
from tolerances import CERTIFICATE_MARGIN

from jaxtube.scenario import load
from jaxtube.synthesis.certificate import terminal as terminal_conditions
from jaxtube.synthesis.certificate.period import find_disturbances
from jaxtube.synthesis.certificate.stages import margins_along_reference
from jaxtube.synthesis.certificate.terminal import check_any_order
from jaxtube.synthesis.gains import Gain, StretchedGain
from jaxtube.synthesis.parts import Condensed, Design
from jaxtube.synthesis.problem import region_corners
from jaxtube.synthesis.tightening import BACK_OFF, find_back_off, tighten
from sets.certificate import Certificate, escape_excess
from sets.polytope import Polytope
from sets.tubes import hull_tube

REQUIRED = [
    "error_sets_not_empty",
    "input_sets_not_empty",
    "terminal_constraint_not_empty",
    "tightening_covers_reach",
    "shifted_plan_inclusion",
    "terminal_set_invariant",
    "terminal_set_admissible",
    "plan_stays_feasible",
    "terminal_cost_decrease",
    "vertices_cover_schedule",
    "plans_keep_these_sets",
    "true_error_in_e",
    "disturbance_bound_proved",
    "solver_residual",
]
PREMISE = "disturbance_bound_proved"  # the paper's W, which is assumed, is refuted
SLACK = 1e-8

find_disturbances_once = functools.cache(find_disturbances)
"""The same by problem, of which most cases change nothing."""


@pytest.fixture
def recertify(monkeypatch):
    """Certify a design again with parts replaced, and its QPs made of them; most conditions for
    information are left out."""
    module = importlib.import_module("jaxtube.synthesis.certificate.certify")
    monkeypatch.setattr(module, "say_what_exists", lambda design: ())
    robot = importlib.import_module("jaxtube.synthesis.certificate.robot")
    monkeypatch.setattr(robot, "find_disturbances", find_disturbances_once)

    def again(design: Design, solver_slack: float = SLACK, **replaced) -> Certificate:
        monkeypatch.setattr(Design, "solver_slack", solver_slack)
        return module.certify(with_own_qps(dataclasses.replace(design, **replaced)))

    return again


@pytest.fixture(scope="module")
def following(uncertified) -> Design:
    """A design of kind T-A: one gain, and the tube of the known reference."""
    return uncertified("paper", *SEQUENCE)


def with_own_qps(design: Design) -> Design:
    """Return the design with QPs made of its parts as they are."""
    parts = (design.problem, design.windows, design.terminal, design.cost.cost, design.bounds)
    return dataclasses.replace(design, condensed=Condensed(*parts))


def required(certificate) -> list[str]:
    """Names of the conditions that a verdict rests on, in their order."""
    return [condition.name for condition in certificate.checked if condition.required]


def but_in_any_order(certificate) -> list[str]:
    """Names of what fails, the condition that repeats others along wheel speeds in random order
    left out."""
    return [name for name in certificate.failing_for_model if name != "any_order_of_wheel_speeds"]


def changed(array: np.ndarray, where, by: float) -> np.ndarray:
    copy = np.array(array)
    copy[where] += by
    return copy


def turned(gain: Gain, by: float) -> Gain:
    return dataclasses.replace(gain, vertices=changed(gain.vertices, (0, 1, 1), by))


# ------------------------------------------------------------------------------------ sound designs


def test_a_design_with_the_tube_of_sums_and_its_own_terminal_gains_is_certified(robust_design):
    certificate = robust_design.certificate
    assert certificate.failing == [PREMISE]
    assert certificate.holds_for_model
    assert not certificate.holds_for_robot
    assert required(certificate) == REQUIRED


def test_a_design_along_the_known_reference_is_certified(following, recertify):
    certificate = recertify(following)
    assert certificate.failing_for_model == []
    assert set(required(certificate)) == {*REQUIRED, "any_order_of_wheel_speeds"}


def test_every_margin_of_a_certified_design_is_finite(robust_design, following, recertify):
    for certificate in (robust_design.certificate, recertify(following)):
        margins = [condition.margin for condition in certificate.checked if condition.required]
        assert np.isfinite(margins).all()


def test_the_papers_own_design_may_lose_its_plan(certified_paper_design):
    assert certified_paper_design.certificate.failing_for_model == ["plan_stays_feasible"]
    assert certified_paper_design.certificate.conditions["plan_stays_feasible"].margin < -0.01


def test_the_papers_certificate_says_for_which_gains_a_terminal_set_exists(certified_paper_design):
    conditions = certified_paper_design.certificate.conditions
    exists = {
        name: condition.holds for name, condition in conditions.items() if not condition.required
    }
    assert exists == {
        "checked_in_rationals": False,
        "invariant_set_for_tube_gain": False,
        "terminal_set_for_trace_s": True,
        "terminal_set_for_trace_p": False,
        "terminal_set_for_logdet": False,
    }


def test_zero_order_hold_is_not_covered_by_its_vertices(uncertified, recertify):
    design = uncertified("robust", "controller.discretisation=zoh", "controller.tube=hull")
    certificate = recertify(design)
    assert "vertices_cover_schedule" in certificate.failing_for_model
    assert "zero-order hold" in certificate.conditions["vertices_cover_schedule"].sentence


# --------------------------------------------------------------- one thing broken in a sound design


@pytest.mark.parametrize("kind", ["errors", "inputs"])
@pytest.mark.parametrize(("window", "stage"), [(0, 2), (-1, -1)])
@pytest.mark.parametrize("sound", ["robust_design", "following"])
def test_a_set_wider_by_a_millimetre_misses_reach_and_inclusion(
    sound, kind, window, stage, recertify, request
):
    design = request.getfixturevalue(sound)
    wider = changed(getattr(design.bounds, kind), (window, stage, 1), 1e-3)
    certificate = recertify(design, bounds=dataclasses.replace(design.bounds, **{kind: wider}))
    assert certificate.failing_for_model == ["tightening_covers_reach", "shifted_plan_inclusion"]
    problem = design.problem
    limits = {"errors": problem.operating_set, "inputs": problem.input_rows}[kind].offsets
    drawn_in = BACK_OFF * (stage % problem.horizon + 1) * limits[1]
    assert certificate.conditions["tightening_covers_reach"].margin == pytest.approx(
        drawn_in - 1e-3, rel=1e-3
    )
    assert not certificate.holds_for_model


@pytest.mark.parametrize("kind", ["errors", "inputs"])
@pytest.mark.parametrize("window", [0, -1])
@pytest.mark.parametrize("sound", ["robust_design", "following"])
def test_a_stage_narrower_by_a_millimetre_breaks_the_inclusion_alone(
    sound, kind, window, recertify, request
):
    design = request.getfixturevalue(sound)
    narrower = changed(getattr(design.bounds, kind), (window, 2, 0), -1e-3)
    certificate = recertify(design, bounds=dataclasses.replace(design.bounds, **{kind: narrower}))
    assert certificate.failing_for_model == ["shifted_plan_inclusion"]
    assert certificate.conditions["shifted_plan_inclusion"].margin == pytest.approx(-1e-3, rel=1e-3)


@pytest.mark.parametrize("window", [0, -1])
@pytest.mark.parametrize("sound", ["robust_design", "following"])
def test_a_terminal_facet_pushed_out_loses_the_plan(sound, window, recertify, request):
    design = request.getfixturevalue(sound)
    pushed = np.array(design.bounds.terminal)
    pushed[window] *= 1.02
    certificate = recertify(design, bounds=dataclasses.replace(design.bounds, terminal=pushed))
    assert certificate.failing_for_model == ["plan_stays_feasible"]


def test_the_last_error_and_input_set_must_receive_the_plan(robust_design, recertify):
    bounds = robust_design.bounds
    for kind, name in (("errors", "E"), ("inputs", "U")):
        narrower = np.array(getattr(bounds, kind))
        narrower[:, -1] *= 0.5
        certificate = recertify(
            robust_design, bounds=dataclasses.replace(bounds, **{kind: narrower})
        )
        assert certificate.failing_for_model == ["terminal_set_admissible", "plan_stays_feasible"]
        assert f"leave {name}_{{N-1}} by" in certificate.conditions["plan_stays_feasible"].sentence


@pytest.mark.parametrize("window", [0, -1])
def test_the_terminal_set_of_every_window_must_receive_the_plan(robust_design, window, recertify):
    smaller = np.array(robust_design.bounds.terminal)
    smaller[window] *= 0.7
    certificate = recertify(
        robust_design, bounds=dataclasses.replace(robust_design.bounds, terminal=smaller)
    )
    assert certificate.failing_for_model == ["plan_stays_feasible"]


def test_the_plan_must_end_in_the_terminal_set_of_the_next_step(following, recertify):
    windows = following.windows
    step = int(np.flatnonzero(np.diff(windows.index))[0])
    both = windows.index[step : step + 2]
    wheels = following.problem.schedule[step:]
    reference = dataclasses.replace(following.problem.reference, wheels=wheels, steps=2)
    problem = dataclasses.replace(following.problem, reference=reference)
    for window, failing in ((both[0], []), (both[1], ["plan_stays_feasible"])):
        smaller = np.array(following.bounds.terminal)
        smaller[window] *= 0.7
        certificate = recertify(
            following,
            problem=problem,
            bounds=dataclasses.replace(following.bounds, terminal=smaller),
            windows=dataclasses.replace(windows, index=both),
        )
        assert certificate.failing_for_model == failing


@pytest.mark.parametrize("sound", ["robust_design", "following"])
def test_a_larger_invariant_set_leaves_the_constraints(sound, recertify, request):
    design = request.getfixturevalue(sound)
    larger = dataclasses.replace(design.terminal, invariant=design.terminal.invariant.scale(1.02))
    assert but_in_any_order(recertify(design, terminal=larger)) == ["terminal_set_admissible"]


def test_a_smaller_set_is_not_invariant(robust_design, recertify):
    smaller = dataclasses.replace(
        robust_design.terminal, invariant=robust_design.terminal.invariant.scale(0.4)
    )
    assert recertify(robust_design, terminal=smaller).failing_for_model == [
        "terminal_set_invariant"
    ]


@pytest.mark.parametrize("sound", ["robust_design", "following"])
def test_a_lower_terminal_cost_does_not_decrease(sound, recertify, request):
    design = request.getfixturevalue(sound)
    cost = dataclasses.replace(design.cost, cost=0.99 * design.cost.cost)
    certificate = recertify(design, cost=cost)
    assert certificate.failing_for_model == ["terminal_cost_decrease"]
    assert certificate.conditions["terminal_cost_decrease"].margin < -1e-3


def test_a_changed_tube_gain_is_not_the_one_of_the_tightening_and_of_the_run(
    robust_design, recertify
):
    certificate = recertify(robust_design, tube_gain=turned(robust_design.tube_gain, 0.05))
    assert "vertices_cover_schedule" in certificate.failing_for_model
    assert "tightening_covers_reach" in certificate.failing_for_model


@pytest.mark.parametrize("sound", ["robust_design", "following"])
def test_a_changed_terminal_gain_fails_what_rests_on_it(sound, recertify, request):
    design = request.getfixturevalue(sound)
    terminal = dataclasses.replace(design.terminal, gains=turned(design.terminal.gains, 0.5))
    failing = but_in_any_order(recertify(design, terminal=terminal))
    assert failing == ["terminal_set_invariant", "plan_stays_feasible", "terminal_cost_decrease"]


def test_sets_made_for_the_known_reference_do_not_serve_every_schedule(following, recertify):
    scenario = load("paper", [*SEQUENCE[:1], "controller.tube=summed", *SEQUENCE[2:]])
    problem = dataclasses.replace(following.problem, scenario=scenario)
    assert "plan_stays_feasible" in recertify(following, problem=problem).failing_for_model


@pytest.mark.parametrize("sound", ["robust_design", "following"])
def test_a_wider_disturbance_is_more_than_the_sets_were_made_for(sound, recertify, request):
    design = request.getfixturevalue(sound)
    problem = dataclasses.replace(
        design.problem, disturbance_set=design.problem.disturbance_set.scale(1.05)
    )
    failing = but_in_any_order(recertify(design, problem=problem))
    assert failing == [
        "tightening_covers_reach",
        "shifted_plan_inclusion",
        "terminal_set_invariant",
        "plan_stays_feasible",
    ]


def test_the_set_must_be_invariant_for_what_w_becomes_whatever_the_design_says(
    robust_design, recertify
):
    terminal = dataclasses.replace(
        robust_design.terminal,
        disturbances=tuple(
            section.image(0.5 * np.eye(3)) for section in robust_design.terminal.disturbances
        ),
        invariant=robust_design.terminal.invariant.scale(0.75),
    )
    assert "terminal_set_invariant" in recertify(robust_design, terminal=terminal).failing_for_model


def test_the_set_must_lie_in_the_limits_whatever_the_design_says(robust_design, recertify):
    terminal = dataclasses.replace(
        robust_design.terminal,
        admissible=robust_design.terminal.admissible.scale(1.2),
        invariant=robust_design.terminal.invariant.scale(1.1),
    )
    failing = recertify(robust_design, terminal=terminal).failing_for_model
    assert "terminal_set_admissible" in failing


@pytest.mark.parametrize("part", ["loops", "gains"])
def test_loops_and_gains_of_the_run_must_be_those_of_the_vertices(part, robust_design, recertify):
    windows = robust_design.windows
    other = changed(getattr(windows, part), (-1, 0, 0, 1), 1e-3)
    certificate = recertify(robust_design, windows=dataclasses.replace(windows, **{part: other}))
    assert certificate.failing_for_model == ["vertices_cover_schedule", "plans_keep_these_sets"]


@pytest.fixture(scope="module")
def plain(uncertified) -> tuple[Design, Gain]:
    """A design under the exact Jacobian, and its decoupled gain taken as bilinear in plain wheel
    speeds: right at the corners of the box, wrong between them."""
    design = uncertified("certified")
    gain = design.tube_gain
    assert isinstance(gain, StretchedGain)
    return design, Gain(gain.model, gain.nominal, gain.vertices, gain.regions)


def test_the_terminal_gain_must_be_covered_too(plain, recertify):
    design, gain = plain
    terminal = dataclasses.replace(design.terminal, gains=gain)
    assert "vertices_cover_schedule" in recertify(design, terminal=terminal).failing_for_model


def test_loops_between_the_corners_are_compared_though_the_run_stays_at_them(plain, recertify):
    design, gain = plain
    corners = region_corners(gain.regions)
    schedules = np.broadcast_to(corners[0], design.windows.schedules.shape)
    at_corner = dataclasses.replace(
        design.windows,
        schedules=schedules,
        loops=gain.loops_along(schedules),
        gains=gain.along(schedules),
    )
    terminal = dataclasses.replace(design.terminal, gains=gain)
    certificate = recertify(design, windows=at_corner, tube_gain=gain, terminal=terminal)
    assert "vertices_cover_schedule" in certificate.failing_for_model


@pytest.mark.parametrize("stage", [1, 3])
@pytest.mark.parametrize("share", [0.9, 1.1])
def test_in_any_order_every_stage_is_tightened_by_reach_and_inclusion(
    stage, share, following, monkeypatch
):
    """A stage that loses less than the reach fails; one that loses more, the stage after it."""
    assert check_any_order(following).holds

    def tighten_one_stage(*parts):
        right = tighten(*parts)
        reach = np.array(right.error_reach)
        reach[:, stage] *= share
        return dataclasses.replace(right, error_reach=reach)

    monkeypatch.setattr(terminal_conditions, "tighten", tighten_one_stage)
    assert not check_any_order(following).holds


def test_in_any_order_the_plan_must_return_to_what_is_left_of_the_set(following):
    """A facet drawn in leaves a set that holds the tube, and is not invariant."""
    omega = following.terminal.invariant
    facet = int(np.argmax(omega.normals[:, 1]))
    offsets = changed(omega.offsets, facet, -0.2 * omega.offsets[facet])
    drawn_in = dataclasses.replace(following.terminal, invariant=Polytope(omega.normals, offsets))
    condition = check_any_order(dataclasses.replace(following, terminal=drawn_in))
    assert not condition.holds


def test_a_schedule_outside_the_box_is_not_covered(robust_design, recertify):
    problem = robust_design.problem
    smaller = problem.regions - [[[0.0], [0.1]]]
    narrow = dataclasses.replace(problem, regions=smaller)
    failing = recertify(robust_design, problem=narrow).failing_for_model
    assert "vertices_cover_schedule" in failing


def test_a_solver_that_misses_constraints_by_more_than_the_back_off_fails(robust_design, recertify):
    failing = recertify(robust_design, solver_slack=2e-7).failing_for_model
    assert failing == ["shifted_plan_inclusion", "solver_residual"]


def test_an_empty_tightened_set_fails(robust_design, recertify):
    bounds = robust_design.bounds
    for kind, name in (("errors", "error_sets_not_empty"), ("inputs", "input_sets_not_empty")):
        emptied = np.array(getattr(bounds, kind))
        emptied[:, -1] = -0.1
        certificate = recertify(
            robust_design, bounds=dataclasses.replace(bounds, **{kind: emptied})
        )
        last = ["terminal_set_admissible", "plan_stays_feasible"]
        assert certificate.failing_for_model == [name, *last]
    emptied = dataclasses.replace(bounds, terminal=np.full_like(bounds.terminal, -0.1))
    assert (
        "terminal_constraint_not_empty"
        in recertify(robust_design, bounds=emptied).failing_for_model
    )


# --------------------------------------------------------------------------- no terminal set at all


def test_an_empty_terminal_set_is_reported_with_the_run_that_shows_it(uncertified, recertify):
    design = uncertified("paper", "controller.lmi_objective=trace_p")
    assert design.terminal.invariant is None
    condition = recertify(design).conditions["terminal_set_invariant"]
    assert not condition.holds
    assert -1e-2 < condition.margin < 0
    assert f"in {len(design.terminal.maximal.escape.loops) + 1} steps" in condition.sentence
    passed = f"the lateral error goes {-condition.margin:.3g} m past its limit"
    assert passed in condition.sentence


def test_a_run_that_does_not_leave_proves_nothing(uncertified, recertify):
    design = uncertified("paper", "controller.lmi_objective=trace_p")
    shown = design.terminal.maximal.escape
    for escape in (None, dataclasses.replace(shown, loops=shown.loops[1:])):
        maximal = dataclasses.replace(design.terminal.maximal, escape=escape)
        condition = recertify(
            design, terminal=dataclasses.replace(design.terminal, maximal=maximal)
        ).conditions["terminal_set_invariant"]
        assert condition.margin == -np.inf
        assert not condition.holds
        assert condition.sentence.startswith("No invariant terminal set was found.")


def test_a_nominal_error_that_is_never_reset_needs_more_room(robust_design, recertify, monkeypatch):
    monkeypatch.setattr(
        importlib.import_module("jaxtube.synthesis.certificate.stages"), "NEVER_RESET_STEPS", 6
    )
    problem = dataclasses.replace(
        robust_design.problem, scenario=load("robust", ["controller.restart=false"])
    )
    certificate = recertify(robust_design, problem=problem)
    assert certificate.failing_for_model == ["nominal_error_never_reset"]
    axes = problem.error_set.normals
    reach = hull_tube(robust_design.tube_gain.loops, problem.disturbance_set, 6)
    missing = np.max(
        reach[6].support(axes) - reach[1].support(axes) - 2 * BACK_OFF * problem.error_set.offsets
    )
    assert certificate.conditions["nominal_error_never_reset"].margin == pytest.approx(
        -missing, abs=CERTIFICATE_MARGIN
    )


def test_a_set_that_backed_off_constraints_alone_exclude_may_exist(uncertified, recertify):
    design = uncertified("paper", "controller.lmi_objective=trace_p")
    escape = design.terminal.maximal.escape
    loops = design.terminal.gains.loops
    excess, _ = escape_excess(
        loops,
        [each.vertices() for each in design.terminal.disturbances],
        escape.normal,
        0.0,
        escape.loops,
    )
    barely = dataclasses.replace(escape, offset=float(excess) - BACK_OFF)
    maximal = dataclasses.replace(design.terminal.maximal, escape=barely)
    terminal = dataclasses.replace(design.terminal, maximal=maximal)
    condition = recertify(design, terminal=terminal).conditions["terminal_set_invariant"]
    assert not condition.holds
    assert "inside constraints backed off by 7e-07 of each" in condition.sentence
    assert "there may be one" in condition.sentence


def test_order_of_wheel_speeds_is_promised_where_it_was_checked(uncertified, following, recertify):
    assert "in any order" in recertify(following).assumptions[2]
    along = uncertified("paper", "controller.tube=sequence", "controller.terminal=T-B")
    assert "in any order" not in recertify(along).assumptions[2]
    shared = uncertified("robust")
    assert "in any order" in recertify(shared).assumptions[2]


def test_a_solver_that_misses_more_than_a_stage_is_backed_off_by_loses_recursion(following):
    once = find_back_off(following.problem)
    parts = (following.problem, following.windows, following.bounds)
    assert margins_along_reference(*parts, 0.5 * once).inclusion > 0
    assert margins_along_reference(*parts, 2.0 * once).inclusion < 0
