"""Laws of the peers of `bench`: each gives the answers of the batched solver, with multipliers of
the same signs; a missing one is named; medians and ratios are those of rounds."""

import importlib.util
import os
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from jaxtube.experiments.bench import qp_topic
from jaxtube.experiments.bench.accuracy import count_wrong, find_residuals
from jaxtube.experiments.bench.peers import catalogue
from jaxtube.experiments.bench.peers.catalogue import tight_peers
from jaxtube.experiments.bench.peers.problems import Problems
from jaxtube.experiments.bench.pinned import run_pinned
from jaxtube.experiments.bench.rounds import OwnClock, spread, time_rounds, write_number

N = 4
ROWS = 9
COUNT = 12


def made_problems() -> Problems:
    """Programs of which most have active rows; some rows have one bound only."""
    generator = np.random.default_rng(3)
    root = generator.normal(size=(N, N))
    A = generator.normal(size=(ROWS, N))
    lower = np.tile(-generator.uniform(0.1, 0.5, ROWS), (COUNT, 1))
    lower[:, ::3] = -np.inf
    upper = generator.uniform(0.1, 0.5, (COUNT, ROWS))
    q = 3 * generator.normal(size=(COUNT, N))
    return Problems(root @ root.T + np.eye(N), A, q, lower, upper)


@pytest.mark.parametrize("peer", tight_peers(), ids=lambda peer: peer.name)
def test_peers_meet_the_conditions_and_agree(peer):
    if not peer.is_installed:
        pytest.skip(peer.cure)
    problems = made_problems()
    with jax.numpy_dtype_promotion("standard"):  # qpax mixes types
        answers = peer.make(problems).answer()
    exact = catalogue.EXACT[0].make(problems).answer()
    assert np.max(find_residuals(problems, answers)) <= 1e-7
    assert count_wrong(answers.x, exact.x) == 0
    assert np.any(exact.multipliers > 1e-3) and np.any(exact.multipliers < -1e-3)


def test_a_wrong_answer_and_one_that_is_no_number_are_counted():
    exact = np.array([[1.0, 2.0], [3.0, 0.0], [0.0, 0.0]])
    x = exact + np.array([[1e-9, 0.0], [0.0, 1e-3], [np.nan, 0.0]])
    assert count_wrong(x, exact) == 2


def test_missing_peers_are_named_with_what_brings_them(monkeypatch):
    there = importlib.util.find_spec
    monkeypatch.setattr(
        catalogue.importlib.util,
        "find_spec",
        lambda name: None if name == "osqp" else there(name),
    )
    table = qp_topic.write_table(SimpleNamespace(solvers=[]))
    assert "OSQP" in table and "pip install osqp" in table and "DAQP" not in table


def test_rounds_alternate_and_the_first_is_not_counted():
    order = []
    work = {name: lambda name=name: order.append(name) for name in "ab"}
    seconds = time_rounds(work, 3, lambda: order.append("-"))
    assert "".join(order) == "abab-ab-ab-"
    assert all(len(values) == 3 for values in seconds.values())


def test_a_clock_counts_each_program_at_the_median_of_its_passes():
    passes = iter([[9.0, 9.0], [1.0, 50.0], [1.0, 2.0], [60.0, 2.0]])
    clock = OwnClock(lambda: np.array(next(passes)))
    for _ in range(4):
        clock.run()
    assert clock.seconds == 1.5


def test_medians_come_with_quartiles_in_plain_numbers():
    assert str(spread(np.array([1.0, 2.0, 3.0, 4.0, 50.0]))) == "3.00 [2.00, 4.00]"
    assert [write_number(each) for each in (9.8, 123456.0, 0.05, 2e-5)] == [
        "9.80",
        "123,456",
        "0.050",
        "2e-05",
    ]


def count_cores() -> int:
    return len(os.sched_getaffinity(0))


def test_pinned_work_has_its_core():
    assert run_pinned(1, count_cores) == 1
