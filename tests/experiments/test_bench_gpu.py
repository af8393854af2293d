"""Laws of `bench gpu`: what a GPU's driver says is read, rows end with the time, the best row tells
the time of a billion laps, and agreement is that of numbers."""

import time
from concurrent.futures import Future
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtube.control.mpc import Diagnostics
from jaxtube.experiments.bench import gpu_record, sweep
from jaxtube.experiments.bench.agreement import Laps, compare
from jaxtube.experiments.bench.programs import Ahead, Program, in_single_precision
from jaxtube.experiments.bench.sweep import Case, Clock, Programs, Row
from jaxtube.experiments.bench.watch import Watch, read_sample
from jaxtube.simulation.rollout import Trajectory

CASE = Case("paper", 64)
STEPS = 300
TASK = SimpleNamespace(checks=SimpleNamespace(transitions=np.zeros((STEPS, 3, 3))))


def made(program: Program) -> Future:
    future: Future = Future()
    future.set_result(program)
    return future


def sleeping(seconds: float) -> Program:
    return Program(lambda *_: time.sleep(seconds), 1.0, 2.0)


def with_checks(programs: dict[int, Future]) -> Programs:
    return Programs(programs, made(sleeping(0.01)))


def test_lines_of_the_driver_are_read_and_others_are_no_sample():
    assert read_sample("97, 1234\n", 5.0) == (5.0, 97.0, 1234.0)
    assert read_sample("97 %, 1234 MiB\n", 5.0) == (5.0, 97.0, 1234.0)
    assert read_sample("[N/A], 1234\n", 5.0) is None
    watch = Watch()
    watch.samples = [sample for t in range(4) if (sample := read_sample(f"{10 * t}, {t}", t))]
    assert watch.mean_utilisation(1, 2) == 15.0 and watch.most_memory(1, 2) == 2.0
    assert watch.mean_utilisation(7, 8) is None and watch.most_memory(7, 8) is None


def test_rows_come_as_programs_do_and_the_last_is_measured_bare_too():
    rows = []
    programs = with_checks({laps: made(sleeping(0.02)) for laps in (100, 200)})
    clock = Clock(time.perf_counter() + 60, 0.0)
    assert sweep.measure_case(CASE, TASK, programs, Watch(), clock, rows.append) == ""
    assert [row.laps_at_once for row in rows] == [100, 200]
    fastest = rows[1]
    assert rows[0].bare_steps_per_s is None
    assert fastest.checked_steps_per_s < fastest.bare_steps_per_s <= 200 * STEPS / 0.01
    assert fastest.laps_per_s <= 200 / 0.02
    assert fastest.checked_steps_per_s == pytest.approx(STEPS * fastest.laps_per_s)


def test_what_does_not_fit_the_time_is_told():
    rows = []
    programs = with_checks({100: made(sleeping(0.0)), 200: Future()})
    clock = Clock(time.perf_counter() + 0.3, 0.0)
    told = sweep.measure_case(CASE, TASK, programs, Watch(), clock, rows.append)
    assert len(rows) == 1 and told == "paper, float64: 200 laps at once: not compiled in time"
    slow = with_checks({100: made(sleeping(0.1)), 200: made(sleeping(0.1))})
    clock = Clock(time.perf_counter() + 0.6, 0.0)
    told = sweep.measure_case(CASE, TASK, slow, Watch(), clock, rows.append)
    assert len(rows) == 2 and told.endswith("200 laps at once: no time left")


def test_an_error_of_the_device_ends_a_case_in_one_line():
    failed: Future = Future()
    failed.set_exception(jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: Out of memory\nmore"))
    clock = Clock(time.perf_counter() + 60, 0.0)
    told = sweep.measure_case(
        CASE, TASK, with_checks({8: failed}), Watch(), clock, lambda row: None
    )
    assert told.startswith("paper, float64: 8 laps at once: ")
    assert told.endswith("RESOURCE_EXHAUSTED: Out of memory")


def test_programs_are_made_in_the_order_in_which_they_are_asked_for():
    order = []
    ahead = Ahead(1)
    futures = [ahead.ask(lambda i=i: order.append(i) or sleeping(0.0)) for i in range(3)]
    broken = ahead.ask(lambda: 1 / 0)
    assert [future.result(timeout=10).seconds for future in futures] == [1.0] * 3
    assert order == [0, 1, 2]
    with pytest.raises(ZeroDivisionError):
        broken.result(timeout=10)


def test_the_best_row_of_a_case_tells_the_time_of_a_billion_laps():
    def row(bits, laps, laps_per_s):
        return Row("paper", bits, laps, 1.0, 2.0, 3.0, laps_per_s, None, None, 5.0)

    rows = [row(64, 8, 1e6), row(64, 16, 4e6), row(32, 8, 2e6)]
    assert gpu_record.find_best(rows) == {Case("paper", 64): rows[1], Case("paper", 32): rows[2]}
    assert f"{1e9 / 4e6 / 60:.1f} min" in gpu_record.summarise(rows, has_gpu=True)
    on_processor = gpu_record.summarise(rows, has_gpu=False)
    assert "min" not in on_processor and "nothing of a GPU was measured" in on_processor


def test_differences_are_the_largest_and_a_number_that_is_none_is_infinite():
    def laps(error, status, events):
        told = Diagnostics(np.array([[status]]), np.zeros((1, 1)), *[np.zeros((1, 1), bool)] * 2)
        zero = np.zeros((1, 1, 2))
        return Laps(Trajectory(np.full((2, 1, 3), error), zero, zero, zero, zero, told), events)

    one = laps(1.0, 0, np.array([[1, 2]]))
    found = compare(one, laps(1.25, 2, np.array([[2, 1]])))
    assert found.largest == {"errors": 0.25, "inputs": 0.0, "wheels": 0.0}
    assert found.other_diagnostics == 1 and found.events_differ == 2
    assert compare(one, laps(np.nan, 0, one.events)).largest["errors"] == np.inf


def test_single_precision_rounds_real_numbers_alone():
    rounded = in_single_precision({"a": jnp.ones(2), "b": jnp.arange(2), "c": 0.1})  # type: ignore
    assert rounded["a"].dtype == jnp.float32 and rounded["b"].dtype == jnp.arange(2).dtype
    assert rounded["c"] == 0.1
