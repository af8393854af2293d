"""Laws of `doctor`: what does not work is named with its cure and ends with 1, what is optional
never does, and a wrong number is noticed."""

from types import SimpleNamespace

import numpy as np
import pytest
from packaging.requirements import Requirement

from jaxtube.experiments.cli import main
from jaxtube.experiments.doctor import command, machine, numerics, packages
from jaxtube.experiments.doctor.finding import Check, Finding, run_checks
from jaxtube.experiments.doctor.report import say_verdict
from sets.polytope import Polytope


@pytest.mark.slow
def test_a_certified_closed_loop_stays_in_its_limits():
    assert "19,200 periods of `robust`" in numerics.drive_certified_laps()


def test_an_installation_that_runs_the_tests_is_ready(capsys, monkeypatch):
    monkeypatch.setattr(numerics, "CHECKS", numerics.CHECKS[:2])  # the third one compiles laps
    assert main(["doctor"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("ready: ")
    assert max(map(len, lines)) <= 100
    names = {line.split()[1] for line in lines if line.startswith("ok ")}
    assert {"python", "jax", "numpy", "HiGHS", "Clarabel", "devices", "float64"} <= names


def test_a_fault_is_named_with_its_cure_and_ends_with_1(monkeypatch, capsys):
    found = [
        Finding("numpy", "missing", "is not installed", "pip install numpy"),
        Finding("ffmpeg", "missing", "is not on the PATH", "install ffmpeg", is_needed=False),
    ]
    monkeypatch.setattr(command, "examine", lambda: found)
    assert main(["doctor"]) == 1
    text = capsys.readouterr().out
    assert text.startswith("NOT ready, at fault: numpy\n")
    assert "cure: pip install numpy" in text and "cure: install ffmpeg" in text
    assert say_verdict(found[1:]).startswith("ready")
    assert len(say_verdict([Finding(f"package-{i}", "wrong", "") for i in range(99)])) < 100


def test_a_package_is_judged_by_the_versions_that_are_asked_for():
    assert packages.judge_package(Requirement("numpy>=1")).state == "ok"
    assert packages.judge_package(Requirement("numpy>=999")).state == "wrong"
    absent = packages.judge_package(Requirement("no-such-package>=2"))
    assert absent.state == "missing" and absent.cure == "pip install 'no-such-package>=2'"


def test_a_check_that_raises_is_wrong_and_the_others_still_run():
    def fail() -> str:
        raise ImportError("libcuda.so:\n  no such file")

    found = run_checks([Check("devices", fail, "install it"), Check("next", lambda: "works", "")])
    assert found[0] == Finding(
        "devices", "wrong", "ImportError: libcuda.so: no such file", "install it"
    )
    assert found[1].state == "ok"


def test_a_folder_of_compiled_programs_that_cannot_be_written_to_is_wrong(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(machine.CACHE, str(tmp_path / "file" / "below"))
    with pytest.raises(OSError):
        machine.find_cache()
    monkeypatch.setenv(machine.CACHE, str(tmp_path / "new"))
    assert machine.find_cache().startswith("0 files, 0 MiB")


def test_arithmetic_in_32_bits_is_wrong(monkeypatch):
    import jax

    with jax.enable_x64(False), pytest.raises(RuntimeError, match=r"1 \+ 2\^-40 - 1 is 0"):
        machine.find_float64()


def test_a_solver_with_another_answer_is_wrong(monkeypatch):
    halved = lambda cost, rows, limits: (np.array([0.8, 0.6]), None)  # noqa: E731
    monkeypatch.setattr("sets.frame.solve_program", halved)
    with pytest.raises(RuntimeError, match=r"the optimum is 2\.8"):
        numerics.solve_linear_program()
    shifted = lambda *program: SimpleNamespace(x=np.array([2.0, 2.1]))  # noqa: E731
    monkeypatch.setattr("sets.semidefinite.minimise", shifted)
    with pytest.raises(RuntimeError, match="the optimum is 4"):
        numerics.solve_semidefinite_program()


def test_a_certified_lap_that_leaves_its_limits_is_wrong(monkeypatch):
    problem = SimpleNamespace(
        initial_error=np.zeros(3), error_set=Polytope.box(-np.ones(3), np.ones(3))
    )
    made = SimpleNamespace(certificate=SimpleNamespace(holds_for_model=True), problem=problem)
    monkeypatch.setattr("jaxtube.synthesis.design.design", lambda scenario: made)
    for part in ("make_tube_mpc", "linear_plant"):
        monkeypatch.setattr(f"jaxtube.simulation.components.{part}", lambda design: None)
    for size in (1.5, np.nan):
        far = SimpleNamespace(errors=np.full((2, 1, 3), size))
        monkeypatch.setattr("jaxtube.simulation.batches.run_realisations", lambda *loop: far)  # noqa: B023
        with pytest.raises(RuntimeError, match="leaves E by"):
            numerics.drive_certified_laps()


def test_programs_that_are_not_there_are_missing_and_no_fault(monkeypatch):
    monkeypatch.setenv("PATH", "")
    found = machine.find_programs()
    assert [each.state for each in found] == ["missing", "missing"]
    assert not any(each.is_fault for each in found)
