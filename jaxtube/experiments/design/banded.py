"""`design` of a scenario with bands: certify a tracking law scheduled on speed, then attack it.

The attack: references whose wheel speeds jump anywhere in the certified range at every step, or
stay for a while, from starts all over the invariant set, under slips at their extremes, chosen
against the robot, constant and uniform.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from jaxtube.control.laws import ScheduledGain
from jaxtube.experiments.options import Design as DesignOptions
from jaxtube.experiments.run import folder as run_folder
from jaxtube.experiments.run.conditions import condition_lines
from jaxtube.experiments.run.progress import progress
from jaxtube.plant.reference import from_wheels
from jaxtube.plant.slipping import SlippingRobot
from jaxtube.scenario import Scenario
from jaxtube.simulation import closed_loop
from jaxtube.simulation.rollout import realisation_keys
from jaxtube.simulation.starts import uniform_start
from jaxtube.synthesis.bands import BandedLaw, make_law
from jaxtube.synthesis.problem import error_vector
from sets.polytope import Polytope

PROCESSES = ("iid", "vertex", "constant", "adversarial")
REFERENCES, STEPS = 8, 300
"""References under each slip process, each with a block of laps of so many steps."""


@dataclass(frozen=True)
class Attack:
    """Laps under one slip process: how many, and in how many steps something was left, with the
    largest uses."""

    laps: int
    steps: int
    outside_set: int
    outside_w: int
    outside_caps: int
    saturated: int
    used_set: float
    used_w: float


def run(scenario: Scenario, options: DesignOptions) -> int:
    """Run the command; returns 3 where a certificate is required and fails."""
    law = make_law(scenario)
    folder = run_folder.create(scenario, options)
    print(report(law))
    attacks = {}
    if law.invariant.polytope is not None:
        with progress(len(PROCESSES) * REFERENCES, "attacking", "references") as bar:
            attacks = {
                process: attack(law, process, options.seed, bar.update) for process in PROCESSES
            }
        print("\n" + attack_report(attacks))
    folder.save_metrics(metrics(law, attacks))
    print(f"\nwritten to {folder.path}/")
    return 3 if options.require_certificate and not law.certificate.holds else 0


def report(law: BandedLaw) -> str:
    """Return the bands and the certificate as text."""
    problem = law.problem
    lines = [
        "band  mean speed [m/s]  k1 [1/s]  k2 [rad/ms]  k3 [1/s]   W: yaw [deg]   x [mm]   y [mm]   widest use of caps"
    ]
    slowest = problem.scenario.reference.wheel_speed_min_mps
    for m, (band, settings) in enumerate(
        zip(law.bands, problem.scenario.operating.bands, strict=True)
    ):
        bound, (k1, k2, k3) = band.problem.residual, settings.tracking_gains
        assert bound is not None
        yaw, share = np.rad2deg(bound.yaw), law.shares[f"inputs of band {m + 1}"]
        lines.append(
            f"{m + 1:>4}{slowest:>11g} to {settings.below_mps:<5g}{k1:>10g}{k2:>13g}{k3:>10g}{yaw:>15.3f}"
            f"{1e3 * bound.box[0]:>9.2f}{1e3 * bound.box[1]:>9.2f}{share:>21.1%}"
        )
        slowest = settings.below_mps
    errors = ", ".join(f"{name} {law.shares[name]:.1%}" for name in list(law.shares)[:3])
    lines += [
        "",
        f"widest use of the caps on errors: {errors}",
        "",
        "certificate of the scheduled tracking law, without MPC",
    ]
    lines += condition_lines(law.certificate, required=True)
    lines += ["", "assumed", *(f"  * {line}" for line in law.certificate.assumptions)]
    failing = ", ".join(law.certificate.failing)
    box = problem.model.box
    verdict = f"CERTIFIED for wheel speeds of {box[0][0]:g} to {box[1][0]:g} m/s in any order"
    lines += [
        "",
        f"NOT CERTIFIED: {failing}" if failing else verdict,
        "",
        f"designed in {law.seconds:.1f} s",
    ]
    return "\n".join(lines)


def attack(law: BandedLaw, process: str, seed: int, advanced) -> Attack:
    """Run laps of the law under one slip process and count what is left."""
    problem, omega = law.problem, law.invariant.polytope
    assert omega is not None
    noise = error_vector(problem.scenario.noise)
    inner = omega.pontryagin_difference(Polytope.box(-noise, noise)) if noise.any() else omega
    starts = uniform_start(inner.vertices())
    found = []
    for index in range(REFERENCES):
        reference = random_reference(law, np.random.default_rng([seed, index]))
        keys = realisation_keys(seed, index * closed_loop.BLOCK, closed_loop.BLOCK)
        plant = SlippingRobot(
            robot=problem.robot,
            dt=problem.model.dt,
            reference_wheels=jnp.asarray(reference.wheels),
            reference_poses=jnp.asarray(reference.poses),
            nominal_slip=jnp.array(
                [problem.scenario.slip.nominal_right, problem.scenario.slip.nominal_left]
            ),
            relative_error=problem.scenario.slip.relative_error,
            noise=jnp.asarray(noise) if noise.any() else None,
            process=process,
            random=problem.scenario.slip.random,
        )
        gains = jnp.asarray(law.gains(reference.wheels))
        controller = ScheduledGain(gains, closed_loop.make_wheel_map(problem))
        trajectory = closed_loop.simulate(
            controller, plant, np.asarray(starts.draw(keys)), seed + index
        )
        found.append(_count(law, reference.wheels, trajectory))
        advanced()
    totals = [sum(values) for values in list(zip(*found, strict=True))[:6]]
    return Attack(*totals, *(max(values) for values in list(zip(*found, strict=True))[6:]))


def random_reference(law: BandedLaw, generator: np.random.Generator):
    """Return a reference whose wheel speeds jump within the box: at every step, or after stretches
    of up to 3 s."""
    (low, high), model = law.problem.model.box, law.problem.model
    corners = generator.choice([0.0, 1.0], (STEPS, 2))
    shares = np.where(generator.random((STEPS, 1)) < 0.5, corners, generator.random((STEPS, 2)))
    if generator.random() < 0.5:
        shares = np.repeat(shares, generator.integers(2, 30, STEPS), axis=0)[:STEPS]
    return from_wheels(low + shares * (high - low), model.dt, model.track_width)


def _count(law: BandedLaw, wheels, trajectory) -> tuple:
    problem, omega, band = law.problem, law.invariant.polytope, law.band_of(wheels)
    assert omega is not None
    A, B = problem.model.matrices(wheels)
    e, u = trajectory.measured, trajectory.inputs
    w = e[1:] - np.einsum("kij,kbj->kbi", A, e[:-1]) - np.einsum("kij,kbj->kbi", B, u)
    used = np.max(e @ omega.normals.T / omega.offsets, axis=2)
    used_w, outside_caps = np.zeros(w.shape[:2]), np.zeros(w.shape[:2], bool)
    for m, each in enumerate(law.bands):
        at, W, rows = band == m, each.problem.disturbance_set, each.problem.input_rows
        used_w[at] = np.max(w[at] @ W.normals.T / W.offsets, axis=2)
        outside_caps[at] = ~np.all(
            u[at] @ rows.inputs.T + e[:-1][at] @ rows.errors.T <= rows.offsets + 1e-12, axis=2
        )
    saturated = np.any(trajectory.wheels != trajectory.demanded, axis=2)
    counts = [e.shape[1], w.shape[0] * w.shape[1]]
    counts += [int(np.sum(~(used <= 1 + 1e-12))), int(np.sum(~(used_w <= 1 + 1e-12)))]
    return (
        *counts,
        int(outside_caps.sum()),
        int(saturated.sum()),
        float(used.max()),
        float(used_w.max()),
    )


def attack_report(attacks: dict[str, Attack]) -> str:
    """Return the laps run against the law as text."""
    lines = [
        "laps with wheel speeds jumping anywhere in the range, from starts all over the invariant set",
        f"{'slip':<12}{'laps':>8}{'steps':>12}{'left set':>10}{'w left W':>10}{'caps':>8}{'wheels':>8}{'set used':>10}"
        f"{'W used':>8}",
    ]
    for name, a in attacks.items():
        lines.append(
            f"{name:<12}{a.laps:>8,}{a.steps:>12,}{a.outside_set:>10}{a.outside_w:>10}{a.outside_caps:>8}{a.saturated:>8}"
            f"{a.used_set:>10.3f}{a.used_w:>8.3f}"
        )
    return "\n".join(lines)


def metrics(law: BandedLaw, attacks: dict[str, Attack]) -> dict:
    """Return the numbers of the law and of the attack."""
    omega = law.invariant.polytope
    return {
        "shares": law.shares,
        "certified": law.certificate.holds,
        "certificate": {
            name: {"holds": c.holds, "margin": c.margin}
            for name, c in law.certificate.conditions.items()
        },
        "invariant_set_facets": None if omega is None else len(omega.offsets),
        "bands": [
            {"yaw_rad": b.problem.residual.yaw, "box": b.problem.residual.box}
            for b in law.bands
            if b.problem.residual
        ],
        "attack": {name: vars(found) for name, found in attacks.items()},
        "design_seconds": law.seconds,
    }
