"""A simulated log as a witness: of a scenario that fits nothing is refuted, of one that does not
the times are found."""

import re

import numpy as np
import pytest
from made_logs import TRUTH, find, make_log, scenario

from jaxtube.identification.identify import Choices, identify_windows
from jaxtube.identification.words import say_promise
from jaxtube.recordings.windows import Windows
from jaxtube.statistics.intervals import share_interval
from jaxtube.witness.examine import examine
from jaxtube.witness.model_sets import find_model_sets, measure_usage
from jaxtube.witness.shares import QuotedPromise, Share, count_share, find_promise, judge_promise

LONGER_S = 1.0


@pytest.fixture(scope="module")
def simulated():
    return make_log()


@pytest.fixture(scope="module")
def findings(simulated):
    return find(simulated)


@pytest.fixture(scope="module")
def fitting(findings):
    return examine(findings, scenario(), LONGER_S)


def test_a_scenario_that_fits_explains_every_span(fitting):
    for test in (fitting.period, fitting.longer):
        assert len(test.spans.start) > 30
        assert test.verdict.explained.all()
        assert test.stretches() == []
        assert test.share("steady").whole == test.share("steady").commands
    assert fitting.windows.share.inside == fitting.windows.share.count > 10


def test_what_w_is_lies_in_what_is_computed_for_the_whole_operation(fitting):
    sets = fitting.sets
    w = fitting.period.measured[sets.compared]
    assert len(w) > 100
    assert measure_usage(sets.part, w).max() <= 1.0
    assert measure_usage(sets.whole, w).max() <= 1.0
    assert np.all(sets.part.support(np.eye(3)) > 0.0)


def test_a_slip_interval_that_is_too_narrow_is_found_out_with_times(simulated, findings):
    most = 0.15
    narrow = examine(findings, scenario(slip={"right": [0.015, most]}), LONGER_S)
    commands = simulated.drive.commands
    wrong = np.flatnonzero(commands.slip[:, 0] > most + 0.05)
    right = np.flatnonzero(commands.slip[:, 0] < most - 0.01)
    test = narrow.longer
    assert test is not None
    held = simulated.log.step[np.searchsorted(simulated.log.time, test.spans.start - 0.06)]
    last = simulated.log.step[np.searchsorted(simulated.log.time, test.spans.end - 0.06) - 1]
    within = test.spans.is_kind("steady") & (held == last)
    is_wrong = within & np.isin(held, wrong)
    assert is_wrong.sum() > 5
    assert test.verdict.refuted[is_wrong].mean() > 0.8
    assert test.verdict.explained[within & np.isin(held, right)].all()
    windows = narrow.windows
    number = simulated.log.step[np.searchsorted(simulated.log.time, windows.start + 1.0)]
    assert not windows.inside[np.isin(number, wrong)].any()
    assert windows.inside[windows.steady & np.isin(number, right)].all()
    assert windows.share.whole < windows.share.commands


def test_stretches_are_runs_of_spans_the_worst_first(findings):
    narrow = examine(findings, scenario(slip={"right": [0.015, 0.1]}), LONGER_S)
    test = narrow.longer
    assert test is not None
    runs = test.stretches()
    usage = [test.verdict.usage[run].max() for run in runs]
    assert usage == sorted(usage, reverse=True)
    together = np.sort(np.concatenate(runs))
    np.testing.assert_array_equal(together, np.flatnonzero(~test.verdict.explained))
    for run in runs:
        np.testing.assert_allclose(test.spans.start[run[1:]], test.spans.end[run[:-1]])


def test_windows_that_can_be_replayed_are_the_slips_of_the_robot(simulated, fitting):
    time, values = fitting.windows.recorded()
    np.testing.assert_array_equal(time, fitting.windows.start)
    steady = fitting.windows.steady
    number = simulated.log.step[np.searchsorted(simulated.log.time, time[steady] + 1.0)]
    values = values[steady]
    truth = simulated.drive.commands
    wander = TRUTH.slip_wander
    assert np.abs(values[:, :2] - truth.slip[number]).max() < wander + 0.02
    assert np.abs(values[:, 2] - truth.sideslip[number]).max() < 0.01


@pytest.mark.parametrize(
    ("more", "reason"),
    [
        ({"slip": {"measurement_error": 0.02}}, "a log has no such measurement"),
        ({"controller": {"observer_gain": (0.5, 0.5, 0.5)}}, "acts on an estimate"),
        ({"controller": {"dt_s": 0.05}}, "W is of a period of 0.05 s"),
    ],
)
def test_where_w_has_nothing_to_compare_the_reason_is_said(findings, more, reason):
    changed = scenario(**more)
    spans = examine(findings, scenario(), 0.1).period.spans
    assert reason in find_model_sets(changed, spans)


@pytest.mark.parametrize(
    ("more", "longer", "fragment"),
    [
        (
            {"noise": {"longitudinal_m": 0.0, "lateral_m": 0.0, "heading_deg": 0.0}},
            1.0,
            "poses of a log have noise; give the bounds of theirs",
        ),
        ({}, 60.0, "--longer-s = 60.0: is more than 40 periods"),
        ({"robot": {"wheel_speed_min_mps": 2.0, "wheel_speed_max_mps": 3.0}}, 1.0, "drives so"),
    ],
)
def test_what_says_nothing_is_refused_in_one_line(findings, more, longer, fragment):
    with pytest.raises(ValueError, match=re.escape(fragment)) as refused:
        examine(findings, scenario(**more), longer)
    assert "\n" not in str(refused.value)


def test_a_command_is_whole_where_all_of_it_is_inside():
    inside = np.array([True, True, True, False, True, False])
    command = np.array([0, 0, 1, 1, 2, 3])
    share = count_share(inside, command)
    assert share == Share(4, 6, 2, 4)
    assert share.interval == share_interval(2, 4)
    assert count_share(inside[:0], command[:0]).interval == (0.0, 1.0)


@pytest.mark.parametrize(
    ("whole", "commands", "said"),
    [
        (19, 19, "kept"),
        (16, 19, "not contradicted"),
        (5, 19, "BROKEN"),
        (0, 0, "no command that it is about"),
    ],
)
def test_a_promise_is_judged_by_the_interval_of_new_commands(whole, commands, said):
    assert said in judge_promise(Share(whole, commands, whole, commands), QuotedPromise(0.77, ""))


def test_the_promise_of_an_identification_is_found_in_the_comments_of_its_file():
    draw = np.random.default_rng(8)
    wheels = draw.uniform(0.3, 1.0, (60, 2))
    ground = wheels * (1.0 - draw.uniform(0.02, 0.1, (60, 2)))
    velocity = np.column_stack(
        [ground.mean(axis=1), (ground[:, 0] - ground[:, 1]) / 0.7, np.zeros(60)]
    )
    yes = np.ones(60, dtype=bool)
    windows = Windows("made", np.arange(60), wheels, velocity, yes, ~yes)
    identified = identify_windows(windows, Choices())
    words = f"Its box of slips {say_promise(identified)}.".split()
    text = "\n".join(f"# {' '.join(words[k : k + 4])}" for k in range(0, len(words), 4))
    found = find_promise(f"{text}\n[robot]\ntrack_width_m = 0.5\n")
    assert found is not None
    assert found.share == int(100 * identified.promise.share) / 100
    assert find_promise("[robot]\n# nothing\n") is None


def test_a_promise_is_carried_on_with_the_log_it_comes_from():
    text = (
        "# holds for at least 82 % of new commands at 95 % confidence, from 34\n"
        "# SHA-256 of the file begins with 0123456789abcdef.\n"
    )
    first = find_promise(text)
    assert first is not None
    again = find_promise(f"# {first.sentence}\n")
    assert again == first
    assert again.fingerprint == "0123456789abcdef"
