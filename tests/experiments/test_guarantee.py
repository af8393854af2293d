"""Laws of the command `guarantee`: claims follow certificate and counts, laws share a program,
nothing is lost."""

import dataclasses
import json
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pages import find_first_lines
from spoken import leave_out_waits
from tolerances import CLOSED_LOOP

from jaxtube.control.protocol import WheelMap
from jaxtube.experiments.cli import main
from jaxtube.experiments.guarantee import claims, command, report
from jaxtube.experiments.guarantee import page as guarantee_page
from jaxtube.experiments.guarantee.attack import (
    LAWS,
    PROCESSES,
    AnySlipRobot,
    apply_law,
    count_laps,
    make_tasks,
)
from jaxtube.experiments.run.folder import RunFolder
from jaxtube.experiments.run.table import WIDTH
from jaxtube.plant.robot import Robot
from jaxtube.plant.slip_bounds import near_nominal
from jaxtube.plant.slipping import SlippingRobot
from jaxtube.scenario import Scenario, ScenarioError, load
from jaxtube.scenario.tree import RobotTable
from jaxtube.simulation.rollout import realisation_keys
from jaxtube.statistics import run as montecarlo
from jaxtube.statistics.events import EVENT_NAMES, VIOLATIONS, find_event
from jaxtube.statistics.intervals import share_interval
from jaxtube.statistics.montecarlo import make_closed_loop_task, name_law
from jaxtube.statistics.run import BLOCK, Run
from jaxtube.statistics.summary import summarise
from sets.certificate import Certificate, Condition

REFERENCE = "reference.duration_s=2"

# ----------------------------------------------------------------------------------- laws of attack


@pytest.mark.parametrize("realisations", [1, BLOCK, 5 * BLOCK, 5 * BLOCK + 1, 10**5, 10**6])
def test_laps_are_split_evenly_into_whole_blocks_and_no_more_than_needed(realisations):
    laps = count_laps(realisations, BLOCK)
    assert laps % BLOCK == 0
    assert laps >= BLOCK
    assert len(PROCESSES) * (laps - BLOCK) < realisations <= len(PROCESSES) * laps


def test_every_law_has_a_name_of_its_own():
    assert len({law.name for law in LAWS}) == len(LAWS)
    assert {law.process for law in LAWS if not law.edge} == set(PROCESSES)


WHEEL_MAP = WheelMap(0.5, 0.1)


@jax.jit
def drive(robot, keys, errors):
    """Return the errors after the reference, under inputs that follow what is measured."""

    def period(step, carry):
        errors, memory = carry
        measurement, memory = robot.sense(keys, step, memory, errors)
        inputs = measurement.errors[:, :2] / 10
        command = WHEEL_MAP.command(inputs, measurement, robot.reference_wheels[step])
        following, memory, _ = robot.advance(keys, step, memory, errors, command)
        return following, memory

    start = (errors, robot.initial(keys, errors))
    end, _ = jax.lax.fori_loop(0, len(robot.reference_wheels), period, start)
    return end


def test_a_robot_of_any_process_moves_as_the_robot_of_that_process_alone():
    generator = np.random.default_rng(0)
    steps = 12
    laps = 6
    ideal = SlippingRobot(
        robot=Robot(0.5, -3.0, 3.0),
        dt=0.1,
        reference_wheels=jnp.asarray(generator.uniform(1.0, 1.5, (steps, 2))),
        reference_poses=jnp.asarray(generator.normal(size=(steps + 1, 3))),
        slips=near_nominal(np.array([0.2, 0.15]), 0.3, "both"),
        noise=jnp.full(3, 1e-3),
        process=PROCESSES[0],
    )
    keys = realisation_keys(3, 0, laps)
    errors = jnp.asarray(generator.normal(size=(laps, 3)))
    ends = []
    for number, process in enumerate(PROCESSES):
        alone = drive(dataclasses.replace(ideal, process=process), keys, errors)
        numbered = drive(AnySlipRobot(ideal, jnp.asarray(number, jnp.int32)), keys, errors)
        np.testing.assert_allclose(numbered, alone, rtol=0, atol=CLOSED_LOOP)
        ends.append(numbered)
    assert len(np.unique(ends, axis=0)) == len(PROCESSES)


def test_all_laws_of_one_kind_are_one_program(uncertified):
    """What is compiled depends on structure and shapes alone."""
    tasks, why = make_tasks(uncertified("robust", REFERENCE), 0)
    programs = {
        law: (jax.tree.structure(task), str(jax.tree.map(jnp.shape, task)))
        for law, task in tasks.items()
    }
    assert why == ""
    assert tuple(programs) == LAWS
    of_vertices = {programs[law] for law in LAWS if law.process == "vertex"}
    assert len(set(programs.values())) == len(of_vertices) == 2
    assert len(tasks[LAWS[-1]].checks.transitions) == 10


def test_where_no_start_has_a_plan_laps_begin_at_the_scenario_s_start(uncertified, monkeypatch):
    def nowhere(*sets, **settings):
        raise ScenarioError("scenario: no start has a plan")

    monkeypatch.setattr("jaxtube.simulation.choices.true_starts", nowhere)
    design = uncertified("robust", REFERENCE)
    tasks, why = make_tasks(design, 0)
    assert why == "scenario: no start has a plan"
    keys = realisation_keys(0, 0, 3)
    expected = np.tile(design.problem.initial_error, (3, 1))
    for task in tasks.values():
        np.testing.assert_array_equal(task.starts.draw(keys), expected)


# ----------------------------------------------------------------------------------- the same robot


def test_both_designs_drive_the_same_robot_and_keep_their_own_sets():
    first = load(
        "certified",
        ["slip.relative_error=0.07", "robot.wheel_speed_max_mps=2.9", "reference.radius_m=2.6"],
    )
    own = load("paper")
    joined = command.put_on_robot(own, first, "paper")
    for section in ("robot", "slip", "noise", "initial"):
        assert getattr(joined, section) == getattr(first, section)
    for section in ("constraints", "operating", "disturbance", "controller"):
        assert getattr(joined, section) == getattr(own, section)
    for key, source in {"radius_m": first, "speed_mps": first, "wheel_speed_min_mps": own}.items():
        assert getattr(joined.reference, key) == getattr(source.reference, key)


def test_a_path_that_the_other_design_does_not_cover_is_refused_in_one_line():
    fast = load("certified", ["reference.speed_mps=1.45", "reference.wheel_speed_max_mps=1.6"])
    with pytest.raises(ScenarioError, match=r"^--against paper: reference.speed_mps = 1.45: .*$"):
        command.put_on_robot(load("paper"), fast, "paper")


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--scenario", "paper"], "--against = "),
        (["--against", "no-such"], '"no-such"'),
        (["--realisations", "0.5"], "--realisations = 0.5"),
        (["--realisations", "0"], "--realisations = 0"),
    ],
)
def test_bad_words_cost_one_line(words, named, capsys):
    assert main(["guarantee", *words]) == 2
    output = capsys.readouterr()
    assert output.out == ""
    (line,) = leave_out_waits(output.err)
    assert named in line


# ----------------------------------------------------------------------------------- claims, tables

HOLDING = (
    *claims.PREMISE,
    *claims.RECURSION,
    *claims.TERMINAL,
    "true_error_in_e",
    "input_sets_not_empty",
    "wheel_limits",
    "wheel_acceleration",
    "terminal_cost_decrease",
    claims.RATIONALS,
)
ROBOT = (*claims.PREMISE, "true_error_in_e", "wheel_limits", "wheel_acceleration")
LIMITED = Scenario(robot=RobotTable(wheel_acceleration_max_mps2=5.0))


def law(laps=4096, steps=300, plans=8000, usage=0.9, **seen):
    """Return the summary of a law; `seen` are laps with an event, or plans by "cost" and "tube"."""
    events = {
        name: {
            "laps": seen.get(name, 0),
            "share_of_laps": seen.get(name, 0) / laps,
            "share_of_laps_interval": share_interval(seen.get(name, 0), laps),
            "share_of_steps": 0.01,
        }
        for name in EVENT_NAMES
    }
    return {
        "laps": laps,
        "steps_a_lap": steps,
        "events": events,
        "plans": plans,
        "tube": {
            "used": "sequence",
            "plans_outside_by_stage": {"sequence": np.array([0, seen.get("tube", 0)])},
        },
        "cost": {"fell_by_less_than_the_stage": seen.get("cost", 0)},
        "worst": {kind: [{"lap": 7, "usage": usage}] for kind in ("disturbance", "error")},
    }


def make_tested(*failing, absent=(), laws=None, name="mine"):
    conditions = []
    for condition in dict.fromkeys(HOLDING):
        if condition not in absent:
            margin = -0.25 if condition in failing else 0.125
            scope = "robot" if condition in ROBOT else "model"
            conditions.append(Condition(condition, margin, "", scope))
    laws = laws or {"iid": law(), "edge-vertex": law(steps=10)}
    return claims.DesignUnderTest(name, LIMITED, Certificate(tuple(conditions)), laws)


def find_certified(design) -> set[str]:
    return {claim.title for claim in claims.CLAIMS if claims.judge_claim(claim, design).certified}


TITLES = {claim.title for claim in claims.CLAIMS}


def test_where_every_condition_holds_every_claim_is_certified():
    assert find_certified(make_tested()) == TITLES


@pytest.mark.parametrize("condition", claims.PREMISE)
@pytest.mark.parametrize("missing", [False, True])
def test_without_a_disturbance_set_that_holds_nothing_is_certified_of_the_robot(condition, missing):
    design = make_tested(absent=[condition]) if missing else make_tested(condition)
    kept = find_certified(design)
    assert kept <= {claim.title for claim in claims.CLAIMS if not claim.on_robot}
    assert "W holds every disturbance of the robot" not in kept


@pytest.mark.parametrize("condition", sorted(set(HOLDING) - set(claims.PREMISE)))
def test_a_condition_that_fails_takes_its_claims_with_it_and_shows_its_margin(condition):
    design = make_tested(condition)
    resting = [claim for claim in claims.CLAIMS if condition in claim.conditions]
    assert resting
    assert TITLES - find_certified(design) == {claim.title for claim in resting}
    for claim in resting:
        _, proved, _ = report.cells(claim, design)
        assert "(-0.25)" in proved


def test_what_is_claimed_of_laps_rests_on_the_qps_that_run():
    lost = TITLES - find_certified(make_tested("plans_keep_these_sets"))
    assert lost >= {
        "a plan is followed by a plan",
        "the error stays in E",
        "inputs stay in U",
        "wheels stay within their limits",
    }


def test_a_condition_that_was_never_checked_certifies_nothing():
    """Except for the limits of the wheels where they are U itself."""
    for condition in set(HOLDING) - {"wheel_limits"}:
        assert find_certified(make_tested(absent=[condition])) < TITLES
    assert find_certified(make_tested(absent=["wheel_limits"])) == TITLES
    *_, exact = claims.CLAIMS
    assert not claims.judge_claim(exact, make_tested(absent=[claims.RATIONALS])).claimed


SCOPES = {claim.title: claim.scope for claim in claims.CLAIMS}
OF_THE_BOX = "1.224 to 1.496 m/s"
OTHER_GAINS = [
    "controller.tube=summed",
    "controller.terminal=T-B",
    "controller.tracking_gains=[]",
    "controller.model=consistent",
]


@pytest.mark.parametrize(
    ("settings", "conditions", "words"),
    [
        (["controller.tube=sequence"], {}, f"{OF_THE_BOX}, in the order of this path alone"),
        (["controller.tube=sequence"], {claims.ANY_ORDER: 0.1}, f"{OF_THE_BOX}, any order"),
        (
            ["controller.tube=sequence"],
            {claims.ANY_ORDER: -0.1},
            f"{OF_THE_BOX}, in the order of this path alone",
        ),
        (OTHER_GAINS, {}, f"{OF_THE_BOX}, any order"),
        (
            ["controller.tube=sequence", "reference.certified_for=path"],
            {},
            f"those of the path in {OF_THE_BOX}, in the order of this path alone",
        ),
    ],
)
def test_any_order_is_claimed_where_the_certificate_proves_it(settings, conditions, words):
    """A tube that follows the reference is proved along this path; other orders are a condition of
    their own."""
    checked = [Condition(name, margin, "") for name, margin in conditions.items()]
    scenario = load("certified", settings)
    design = claims.DesignUnderTest("mine", scenario, Certificate(tuple(checked)), {})
    assert SCOPES["wheel speeds covered"](design) == words


def test_counts_add_up_over_the_laws_and_name_the_worst_by_its_share():
    laws = {
        "iid": law(e_outside_E=3, tube=2),
        "vertex": law(laps=100, e_outside_E=2),
        "patches": law(cost=5, plans=9),
    }
    design = make_tested(laws=laws)
    by_title = {claim.title: claims.judge_claim(claim, design).seen for claim in claims.CLAIMS}
    assert by_title["the error stays in E"] == claims.Count(5, 8292, "laps", "vertex", 2, 100)
    assert by_title["the tube holds the error around a plan"] == claims.Count(
        2, 16009, "plans", "iid", 2, 8000
    )
    assert by_title["the cost of the model decreases"] == claims.Count(
        5, 16009, "plans", "patches", 5, 9
    )
    assert by_title["inputs stay in U"] == claims.Count(0, 8292, "laps", "", 0, 4096)
    assert by_title["an invariant terminal set exists over the certified wheel speeds"] is None


@pytest.mark.parametrize("event", VIOLATIONS)
def test_each_event_alone_is_a_violation(event):
    assert claims.bound_violating_laps(law(**{event: 11})) == (11, 11)


def test_violating_laps_lie_between_the_largest_count_and_the_sum_and_the_bound_takes_the_most():
    both = {"e_outside_E": 30, "qp_infeasible": 50}
    one = law(laps=1000, **both)
    assert claims.bound_violating_laps(one) == (50, 80)
    assert claims.bound_violating_laps(law(laps=60, **both)) == (50, 60)
    bound = claims.bound_violating_share
    assert bound(one) == bound(law(laps=1000, u_outside_U=80)) > 0.08
    # Clopper and Pearson without events: (1 - bound)^laps = 5 %.
    assert (1 - bound(law(laps=1000))) ** 1000 == pytest.approx(0.05, rel=1e-12)


def test_the_text_keeps_to_its_width_and_the_markdown_table_is_one():
    large = {
        f"edge-{name}": law(laps=10**7, plans=10**9, w_outside_W=10**7, u_outside_U=9, usage=123.4)
        for name in PROCESSES
    }
    designs = [make_tested(*HOLDING, laws=large, name="the-other-one"), make_tested()]
    text = report.text(designs)
    assert max(map(len, text.splitlines())) <= WIDTH
    for design in designs:
        for table in report.law_tables(design):
            assert max(map(len, table.splitlines())) <= WIDTH
    assert "the-other-one: NOT CERTIFIED" in text
    assert "\nmine: CERTIFIED; 0 laps" in text
    markdown = report.markdown(designs)
    for table in markdown.split("\n\n"):
        rows = [line for line in table.splitlines() if line.startswith("|")]
        assert len({row.count("|") for row in rows}) <= 1
    assert all(claim.title in markdown for claim in claims.CLAIMS)


def test_the_legend_explains_every_column_of_an_event():
    legend = report.legend([make_tested()])
    for name in VIOLATIONS:
        event = find_event(name)
        assert f"{event.words}: {event.meaning}" in legend


def test_the_metrics_are_plain_and_hold_every_verdict(tmp_path):
    tested = [make_tested("true_error_in_e"), make_tested(name="other")]
    RunFolder(tmp_path).save_metrics(claims.metrics(tested))
    designs = json.loads((tmp_path / "metrics.json").read_text())["designs"]
    mine = designs["mine"]
    other = designs["other"]
    assert not mine["certified"]
    assert other["certified"]
    assert set(mine["claims"]) == TITLES
    assert mine["claims"]["the error stays in E"]["seen"]["of"] == 8192
    expected = claims.bound_violating_share(law())
    assert other["laws"]["iid"]["share_of_violating_laps_at_most"] == expected


@pytest.mark.parametrize("broken", [(), ("true_error_in_e",)])
def test_the_page_begins_with_what_became_of_the_design_under_test(broken):
    tested = [make_tested(name="other"), make_tested(*broken)]
    page = guarantee_page.make_page(tested, {})
    assert page.verdict.startswith("mine: NOT CERTIFIED" if broken else "mine: CERTIFIED")
    assert page.tone == ("bad" if broken else "good")
    (table, _) = page.sections[0].parts
    assert [row[0] for row in table.rows] == [claim.title for claim in claims.list_claims(tested)]
    by_title = {row[0]: row for row in table.rows}
    proved = by_title["the error stays in E"][2]
    assert proved.tone == ("bad" if broken else "good")
    assert by_title["the error stays in E"][5].tone == "good"


# -------------------------------------------------------------------------------- the whole command

SMALL = 64
WORDS = [
    "guarantee",
    "--scenario",
    "certified",
    "--against",
    "robust",
    "--realisations",
    "640",
    REFERENCE,
]


@pytest.fixture
def small(monkeypatch):
    """Let the command run small blocks on designs without their certificate; returns what makes
    those."""
    make_design = command.make_design

    def design(scenario, options=None):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("jaxtube.synthesis.design.certify", lambda *sets: Certificate())
            return make_design(scenario, options)

    monkeypatch.setattr(command, "make_design", design)
    for module in (montecarlo, command):
        monkeypatch.setattr(module, "BLOCK", SMALL)
    monkeypatch.setattr(montecarlo, "TILE", SMALL // 2)
    # Whoever edits the code while this runs would have the records refused.
    monkeypatch.setattr("jaxtube.experiments.run.folder.source_hashes", dict)
    return design


def test_the_laps_are_announced_with_the_share_that_is_recorded():
    """Whole blocks under every law: more than was asked for."""
    laps = count_laps(5000, command.BLOCK)
    attacks = [
        command.LawRun(name, law, SimpleNamespace(realisations=laps), SimpleNamespace(laps=10))
        for name in ("mine", "other")
        for law in LAWS
    ]
    line = command.describe_laps(attacks)
    total = laps * len(LAWS)
    assert line.startswith(f"{total:,} laps of each of 2 designs, in whole blocks of ")
    assert line.endswith(f"{20 * len(LAWS)} of {2 * total:,} are recorded")


@pytest.mark.slow
def test_an_interrupted_run_goes_on_and_a_law_is_the_monte_carlo_of_its_process(
    small, tmp_path, capsys, monkeypatch
):
    whole = tmp_path / "whole"
    parts = tmp_path / "parts"
    assert main([*WORDS, "--out", str(whole)]) == 0
    assert main([*WORDS, "--out", str(whole), "--require-certificate"]) == 3
    compute = Run.compute
    seen = []

    def interrupted(self, blocks):
        for block, statistics in compute(self, blocks):
            seen.append(block)
            if len(seen) == 9:
                raise KeyboardInterrupt
            yield block, statistics

    with monkeypatch.context() as patch:
        patch.setattr(Run, "compute", interrupted)
        assert main([*WORDS, "--out", str(parts)]) == 4
    assert main([*WORDS, "--out", str(parts)]) == 0
    for name in ("metrics.json", "guarantee.md"):
        assert (whole / name).read_bytes() == (parts / name).read_bytes()
    laws = json.loads((whole / "metrics.json").read_text())["designs"]["certified"]["laws"]
    assert set(laws) == {law.name for law in LAWS}
    assert all(law["laps"] == 128 for law in laws.values())
    verdict, printed = find_first_lines(whole)
    assert verdict == printed

    attacking = LAWS[-1]
    recorded = laws[attacking.name]
    alone = apply_law(small(load("certified", [REFERENCE])), attacking)
    task = make_closed_loop_task(alone, "tube_mpc", "robot", attacking.starts, None, 0)
    run = Run(task, 128, 1, tuple(jax.local_devices()[:1]))
    statistics = montecarlo.merge(*(counts for _, counts in run.compute([0, 1])))
    sampling = name_law(alone, "tube_mpc", "robot", attacking.starts)
    expected = summarise(alone, sampling, statistics)
    assert recorded["law"] == expected["law"]
    for event, numbers in expected["events"].items():
        assert recorded["events"][event]["steps"] == numbers["steps"]
    usage = recorded["worst"]["disturbance"][0]["usage"]
    assert usage == pytest.approx(expected["worst"]["disturbance"][0]["usage"], rel=1e-9)
