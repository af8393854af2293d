"""jaxtube: robust tube-MPC for a wheeled robot that slips, differentiable and batched, in JAX.

    import jaxtube as jt

    design = jt.design(jt.load("certified"))      sets, gains, controllers and their certificate
    laps = jt.simulate(design)                    laps of a closed loop
    run = jt.montecarlo(design, laps=100_000)     laps by the million, every period checked
    worst = jt.falsify(design)                    the worst case, by gradient
    tuned = jt.tune(jt.load("untuned"))           weights and gains, by gradient
    stepper = jt.Stepper(design)                  the controller of one robot, period by period
    governor = jt.Governor(design)                the same from anywhere, for wishes at any time
    jt.save(design, "my_design")                  for jt.read, in another process, to the bit
    jt.export(design, "controller")               the same as NumPy and C99, certified as written
    jt.write_certificate(design, "proof")         the proof, with a program that checks it alone

Any other linear system, parameter-varying in a polytope, is a `jt.LinearSystem`, and a nonlinear
one that it stands for a `jt.Motion`: the same functions take them.

Controllers and plants of your own fit `jt.Controller` and `jt.Plant`, slip processes
`jt.SlipProcess`. What these functions compute on the device they compute in 64 bits, whatever JAX
is configured to. Names are imported when they are first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jaxtube.control.protocol import Controller, Feedback, WheelMap
    from jaxtube.exporting.write import Exported, export
    from jaxtube.falsification.falsify import Falsification, falsify
    from jaxtube.falsification.linear import LinearFalsification
    from jaxtube.plant.protocol import Command, Measurement, Plant
    from jaxtube.plant.slip import SlipProcess
    from jaxtube.results import read, save
    from jaxtube.scenario.reading import load
    from jaxtube.scenario.refusal import ScenarioError
    from jaxtube.scenario.tree import Scenario
    from jaxtube.simulation.governor import GovernedStep, Governor
    from jaxtube.simulation.linear_laps import LinearLaps
    from jaxtube.simulation.simulate import Laps, simulate
    from jaxtube.simulation.stepper import Step, Stepper
    from jaxtube.statistics.linear_montecarlo import LinearMonteCarlo
    from jaxtube.statistics.montecarlo import MonteCarlo, montecarlo
    from jaxtube.synthesis.design import EmptySetError, design
    from jaxtube.synthesis.parts import Design, LinearDesign
    from jaxtube.synthesis.proof_file import write_certificate
    from jaxtube.systems.motion import Motion
    from jaxtube.systems.system import LinearSystem
    from jaxtube.tuning.linear import LinearTuned
    from jaxtube.tuning.tune import Tuned, tune

HOMES = {
    "Command": "jaxtube.plant.protocol",
    "Controller": "jaxtube.control.protocol",
    "Design": "jaxtube.synthesis.design",
    "EmptySetError": "jaxtube.synthesis.design",
    "Exported": "jaxtube.exporting.write",
    "Falsification": "jaxtube.falsification.falsify",
    "Feedback": "jaxtube.control.protocol",
    "GovernedStep": "jaxtube.simulation.governor",
    "Governor": "jaxtube.simulation.governor",
    "Laps": "jaxtube.simulation.simulate",
    "LinearDesign": "jaxtube.synthesis.parts",
    "LinearFalsification": "jaxtube.falsification.linear",
    "LinearLaps": "jaxtube.simulation.linear_laps",
    "LinearMonteCarlo": "jaxtube.statistics.linear_montecarlo",
    "LinearSystem": "jaxtube.systems.system",
    "LinearTuned": "jaxtube.tuning.linear",
    "Measurement": "jaxtube.plant.protocol",
    "MonteCarlo": "jaxtube.statistics.montecarlo",
    "Motion": "jaxtube.systems.motion",
    "Plant": "jaxtube.plant.protocol",
    "Scenario": "jaxtube.scenario",
    "ScenarioError": "jaxtube.scenario",
    "SlipProcess": "jaxtube.plant.slip",
    "Step": "jaxtube.simulation.stepper",
    "Stepper": "jaxtube.simulation.stepper",
    "Tuned": "jaxtube.tuning.tune",
    "WheelMap": "jaxtube.control.protocol",
    "design": "jaxtube.synthesis.design",
    "export": "jaxtube.exporting.write",
    "falsify": "jaxtube.falsification.falsify",
    "load": "jaxtube.scenario",
    "montecarlo": "jaxtube.statistics.montecarlo",
    "read": "jaxtube.results",
    "save": "jaxtube.results",
    "simulate": "jaxtube.simulation.simulate",
    "tune": "jaxtube.tuning.tune",
    "write_certificate": "jaxtube.synthesis.proof_file",
}
"""The module of each name."""

__all__ = [
    "Command",
    "Controller",
    "Design",
    "EmptySetError",
    "Exported",
    "Falsification",
    "Feedback",
    "GovernedStep",
    "Governor",
    "Laps",
    "LinearDesign",
    "LinearFalsification",
    "LinearLaps",
    "LinearMonteCarlo",
    "LinearSystem",
    "LinearTuned",
    "Measurement",
    "MonteCarlo",
    "Motion",
    "Plant",
    "Scenario",
    "ScenarioError",
    "SlipProcess",
    "Step",
    "Stepper",
    "Tuned",
    "WheelMap",
    "design",
    "export",
    "falsify",
    "load",
    "montecarlo",
    "read",
    "save",
    "simulate",
    "tune",
    "write_certificate",
]


def __getattr__(name: str) -> Any:
    if name not in HOMES:
        raise AttributeError(f"module 'jaxtube' has no attribute {name!r}")
    return getattr(importlib.import_module(HOMES[name]), name)


def __dir__() -> list[str]:
    return __all__
