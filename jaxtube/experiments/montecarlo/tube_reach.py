"""How tight the four tubes are: deviations sampled under switching schedules, and the exact reach
of every facet.

    deviation+ = Phi(th) deviation + w,   w in W,   th anywhere in its box (`sequence`: along the
                                                    reference)
    reach of c after N steps = max over sequences of sum_m h_W([Phi_{N-1} .. Phi_m]^T c)

A facet's ratio is its offset over that reach: 1 is exact, more is conservative, less would refute
the tube.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxtube.experiments.run.table import Column, format_table, left
from jaxtube.synthesis.parts import Design
from sets.certificate import reach_supports
from sets.polytope import Polytope
from sets.tubes import sequence_tube

SAMPLES = 1_000_000
PART = 50_000
"""Samples drawn at once."""


class Excess(NamedTuple):
    """Largest excess of sampled deviations over any facet of any section."""

    switching: dict[str, float]  # by tube, under switching schedules
    along: float  # of `sequence`, along the reference


def metrics(design: Design, seed: int) -> dict:
    """Return, by tube, the largest excess of sampled deviations over any facet and the facets'
    ratios at j = N."""
    excess = sample_deviations(design, seed)
    W = design.problem.disturbance_set.vertices()
    by_tube = {}
    for name, sections in design.tubes.items():
        if sections.follows_reference:
            ratios = _ratios_along(design)
            numbers = {"largest_excess": excess.along, "least_share_reached": 1 / ratios.max()}
        else:
            facets = sections[-1].polytope().with_unit_normals()
            ratios = facets.offsets / _reach(design, W, facets, len(sections) - 1)
            numbers = {"largest_excess": excess.switching[name]}
        by_tube[name] = numbers | {
            "samples": SAMPLES,
            "facets": len(ratios),
            "ratio_to_reach": {
                "least": ratios.min(),
                "mean": ratios.mean(),
                "greatest": ratios.max(),
            },
        }
    return by_tube


def table(by_tube: dict) -> str:
    """Return the numbers of `metrics` as text."""
    columns = [
        left("tube"),
        Column("samples"),
        Column("largest excess"),
        Column("facets of R_N"),
        *(Column(f"offset / exact reach\n{statistic}") for statistic in ("least", "mean", "most")),
    ]
    rows = [_row(name, numbers) for name, numbers in by_tube.items()]
    return (
        "tubes against w in W and schedules that switch at will (`sequence`: along the reference)\n"
        f"{format_table(columns, rows)}\n"
        "the closed-form worst w, played along the reference, reaches every facet of `sequence` to "
        f"{by_tube['sequence']['least_share_reached']:.4%} at least"
    )


def _row(name: str, numbers: dict) -> list[str]:
    ratios = numbers["ratio_to_reach"].values()
    return [
        name,
        f"{numbers['samples']:,}",
        f"{numbers['largest_excess']:.3g}",
        str(numbers["facets"]),
        *(f"{ratio:.6f}" for ratio in ratios),
    ]


def _reach(
    design: Design, W: Float[np.ndarray, "v 3"], facets: Polytope, steps: int
) -> Float[np.ndarray, " facets"]:
    """Return the exact reach of each facet after some steps."""
    loops = design.tube_gain.loops
    return np.array([reach_supports(loops, W, normal, steps)[0][-1] for normal in facets.normals])


def sample_deviations(design: Design, seed: int) -> Excess:
    """Sample deviations from every tube."""
    tubes = {}
    for name, sections in design.tubes.items():
        if not sections.follows_reference:
            tubes[name] = [section.polytope().with_unit_normals() for section in sections[1:]]
    return Excess(_sample_switching(design, tubes, seed), _sample_along(design, seed))


def _sample_switching(
    design: Design, tubes: dict[str, list[Polytope]], seed: int
) -> dict[str, float]:
    """Return the largest excess by tube under schedules that switch between the corner loops."""
    W = design.problem.disturbance_set.vertices()
    loops = design.tube_gain.loops
    excess = dict.fromkeys(tubes, -np.inf)
    for part in range(SAMPLES // PART):
        generator = np.random.default_rng([seed, part])
        choices = generator.integers(len(loops), size=(design.problem.horizon, PART))
        every_w = [W] * design.problem.horizon
        for stage, points in enumerate(_deviations(loops[choices], every_w, generator)):
            for name, sections in tubes.items():
                excess[name] = max(excess[name], _largest_excess(sections[stage], points))
    return excess


def _sample_along(design: Design, seed: int) -> float:
    """Return the largest excess over the sections of `sequence`, each window along its loops."""
    by_window = design.windows.loops
    samples = -(-SAMPLES // len(by_window))
    excess = -np.inf
    for window, loops in enumerate(by_window):
        every_w = design.problem.disturbances.of_periods(design.windows.regimes[window])
        sections = [
            section.polytope().with_unit_normals() for section in sequence_tube(loops, every_w)[1:]
        ]
        generator = np.random.default_rng([seed, SAMPLES // PART + window])
        known = np.broadcast_to(loops[:, None], (len(loops), samples, 3, 3))
        vertices = [one.vertices() for one in every_w]
        for stage, points in enumerate(_deviations(known, vertices, generator)):
            excess = max(excess, _largest_excess(sections[stage], points))
    return excess


def _deviations(
    loops: Float[np.ndarray, "horizon samples 3 3"],
    every_w: list[Float[np.ndarray, "v 3"]],
    generator: np.random.Generator,
) -> Iterator[Float[np.ndarray, "samples 3"]]:
    """Yield deviations after 1 .. N steps; half of the samples keep to vertices of the W of each
    period, half are uniform mixtures."""
    samples = loops.shape[1]
    deviation = np.zeros((samples, 3))
    for loop, W in zip(loops, every_w, strict=True):
        weights = generator.exponential(size=(samples, len(W)))
        weights[: samples // 2] = np.eye(len(W))[generator.integers(len(W), size=samples // 2)]
        w = weights / weights.sum(axis=1, keepdims=True) @ W
        deviation = np.einsum("sij,sj->si", loop, deviation) + w
        yield deviation


def _largest_excess(polytope: Polytope, points: Float[np.ndarray, "samples 3"]) -> float:
    """Return by how much points pass facets at most; negative inside."""
    return float(np.max(points @ polytope.normals.T - polytope.offsets))


def _ratios_along(design: Design) -> Float[np.ndarray, " facets"]:
    """Return the ratios of the facets of `sequence`, all windows, to what their worst disturbances
    reach, played."""
    ratios = []
    for window, loops in enumerate(design.windows.loops):
        every_w = design.problem.disturbances.of_periods(design.windows.regimes[window])
        facets = sequence_tube(loops, every_w)[-1].polytope().with_unit_normals()
        ends = _worst_ends(loops, [one.vertices() for one in every_w], facets.normals)
        ratios.append(facets.offsets / np.einsum("fi,fi->f", facets.normals, ends))
    return np.concatenate(ratios)


def _worst_ends(
    loops: Float[np.ndarray, "horizon 3 3"],
    every_w: list[Float[np.ndarray, "v 3"]],
    normals: Float[np.ndarray, "f 3"],
) -> Float[np.ndarray, "f 3"]:
    """Return where each direction's worst disturbances, argmax of w' [Phi .. Phi]^T c, end when
    they are played."""
    directions = normals
    disturbances = []
    for loop, W in zip(loops[::-1], every_w[::-1], strict=True):
        disturbances.append(W[np.argmax(directions @ W.T, axis=1)])
        directions = directions @ loop
    deviation = np.zeros_like(normals)
    for loop, w in zip(loops, disturbances[::-1], strict=True):
        deviation = deviation @ loop.T + w
    return deviation
