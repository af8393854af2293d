"""`doctor`: versions, devices, 64-bit arithmetic, solvers, folders, and a closed loop that is
certified; nothing but compiled programs is written."""

from __future__ import annotations

import time

from jaxtube.experiments.doctor import machine, numerics
from jaxtube.experiments.doctor.finding import Finding, run_checks
from jaxtube.experiments.doctor.packages import find_packages
from jaxtube.experiments.doctor.report import report
from jaxtube.experiments.options import DoctorOptions
from jaxtube.experiments.run.exit_codes import ExitCode
from jaxtube.progress import announce
from jaxtube.scenario.refusal import refusal
from jaxtube.scenario.tree import Scenario


def run(scenario: Scenario | None, options: DoctorOptions) -> int:
    """Run the command; returns 1 where something that is needed is missing or wrong.

    Raises:
        ScenarioError: for an override, of which nothing here takes notice.
    """
    if options.overrides:
        cure = "leave it out"
        raise refusal("command line", "override", options.overrides[0], "is of no use here", cure)
    started = time.perf_counter()
    announce("checking: about 5 s; a first run compiles, which takes as long again")
    findings = examine()
    print(report(findings, time.perf_counter() - started))
    is_at_fault = any(finding.is_fault for finding in findings)
    return ExitCode.NOT_READY if is_at_fault else ExitCode.DONE


def examine() -> list[Finding]:
    """Return everything that was found, in the order in which it is told."""
    return [
        *find_packages(),
        *run_checks([*machine.CHECKS, *numerics.CHECKS]),
        *machine.find_programs(),
    ]
