"""How tight the four tubes are: deviations sampled under switching schedules, and the exact reach
of every facet.

    deviation+ = Phi(th) deviation + w,   w in W,   th anywhere in its box (`sequence`: along the reference)
    reach of c after N steps = max over sequences of sum_m h_W([Phi_{N-1} .. Phi_m]^T c)

A facet's ratio is its offset over that reach: 1 is exact, more is conservative, less would refute
the tube.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from jaxtube.synthesis.design import Design
from sets.certificate import reach_supports
from sets.polytope import Polytope
from sets.tubes import Section, sequence_tube

SAMPLES, PART = 1_000_000, 50_000


def metrics(design: Design, seed: int) -> dict:
    """Return, by tube, the largest excess of sampled deviations over any facet and the facets'
    ratios at j = N."""
    switching, along = _sampled(design, seed)
    W = design.problem.disturbance_set.vertices()
    found = {}
    for name, sections in design.tubes.items():
        facets = _unit_facets(sections[-1])
        if sections.follows_reference:
            ratios = _ratios_along(design, W)
            found[name] = {"largest_excess": along, "least_share_reached": 1 / ratios.max()}
        else:
            loops = design.tube_gain.loops
            steps = len(sections) - 1
            reach = np.array(
                [reach_supports(loops, W, normal, steps)[0][-1] for normal in facets.normals]
            )
            ratios = facets.offsets / reach
            found[name] = {"largest_excess": switching[name]}
        found[name] |= {
            "samples": SAMPLES,
            "facets": len(ratios),
            "ratio_to_reach": {
                "least": ratios.min(),
                "mean": ratios.mean(),
                "greatest": ratios.max(),
            },
        }
    return found


def table(found: dict) -> str:
    """Return the numbers of `metrics` as text."""
    lines = [
        "tubes against w in W and schedules that switch at will (`sequence`: along the reference)",
        f"{'tube':<10}{'samples':>12}{'largest excess':>18}{'facets of R_N':>16}"
        f"{'offset / exact reach, least, mean, most':>42}",
    ]
    for name, numbers in found.items():
        ratio = numbers["ratio_to_reach"]
        spread = f"{ratio['least']:.6f}  {ratio['mean']:.6f}  {ratio['greatest']:.6f}"
        lines.append(
            f"{name:<10}{numbers['samples']:>12,}{numbers['largest_excess']:>18.3g}{numbers['facets']:>16}{spread:>42}"
        )
    lines.append(
        "the closed-form worst w, played along the reference, reaches every facet of `sequence` to "
        f"{found['sequence']['least_share_reached']:.4%} at least"
    )
    return "\n".join(lines)


def _unit_facets(section: Section) -> Polytope:
    polytope = section.polytope()
    scale = np.linalg.norm(polytope.normals, axis=1)
    return Polytope(polytope.normals / scale[:, None], polytope.offsets / scale)


def _sampled(design: Design, seed: int) -> tuple[dict[str, float], float]:
    """Return the largest excess over any facet of any section: by tube under switching schedules,
    and along it."""
    W, N = design.problem.disturbance_set.vertices(), design.problem.horizon
    shared = {
        name: [_unit_facets(s) for s in found[1:]]
        for name, found in design.tubes.items()
        if not found.follows_reference
    }
    tubes = [
        sequence_tube(loops, design.problem.disturbance_set)[1:] for loops in design.windows.loops
    ]
    windows = [[_unit_facets(section) for section in sections] for sections in tubes]
    vertices = design.tube_gain.loops
    excess, along = dict.fromkeys(shared, -np.inf), -np.inf
    for part in range(SAMPLES // PART):
        generator = np.random.default_rng([seed, part])
        switched = vertices[generator.integers(len(vertices), size=(N, PART))]
        for j, points in enumerate(_deviations(switched, W, generator)):
            for name, sections in shared.items():
                excess[name] = max(excess[name], float(np.max(_excess(sections[j], points))))
    for window, sections in enumerate(windows):
        generator = np.random.default_rng([seed, SAMPLES // PART + window])
        known = np.broadcast_to(
            design.windows.loops[window][:, None], (N, -(-SAMPLES // len(windows)), 3, 3)
        )
        for j, points in enumerate(_deviations(known, W, generator)):
            along = max(along, float(np.max(_excess(sections[j], points))))
    return excess, along


def _deviations(
    loops: Float[np.ndarray, "horizon samples 3 3"], W: Float[np.ndarray, "v 3"], generator
):
    """Yield deviations after 1 .. N steps; half of the samples keep to the vertices of W, half are
    uniform mixtures."""
    samples = loops.shape[1]
    deviation = np.zeros((samples, 3))
    for loop in loops:
        weights = generator.exponential(size=(samples, len(W)))
        weights[: samples // 2] = np.eye(len(W))[generator.integers(len(W), size=samples // 2)]
        w = weights / weights.sum(axis=1, keepdims=True) @ W
        deviation = np.einsum("sij,sj->si", loop, deviation) + w
        yield deviation


def _excess(
    polytope: Polytope, points: Float[np.ndarray, "samples 3"]
) -> Float[np.ndarray, "samples f"]:
    return points @ polytope.normals.T - polytope.offsets


def _ratios_along(design: Design, W: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, " facets"]:
    """Return the ratios of the facets of `sequence`, all windows, to what their worst disturbances
    reach, played."""
    ratios = []
    for loops in design.windows.loops:
        facets = _unit_facets(sequence_tube(loops, design.problem.disturbance_set)[-1])
        ratios.append(
            facets.offsets
            / np.einsum("fi,fi->f", facets.normals, _worst_end(loops, W, facets.normals))
        )
    return np.concatenate(ratios)


def _worst_end(
    loops: Float[np.ndarray, "horizon 3 3"],
    W: Float[np.ndarray, "v 3"],
    normals: Float[np.ndarray, "f 3"],
):
    """Return where each direction's worst disturbances, argmax of w' [Phi .. Phi]^T c, end when
    they are played."""
    directions, choices = normals, []
    for loop in loops[::-1]:
        choices.append(W[np.argmax(directions @ W.T, axis=1)])
        directions = directions @ loop
    deviation = np.zeros_like(normals)
    for loop, w in zip(loops, choices[::-1], strict=True):
        deviation = deviation @ loop.T + w
    return deviation
