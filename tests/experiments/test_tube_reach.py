"""Laws of the reach of the tubes: no facet is passed, what is exact is told as exact, a tube too
small is found out."""

import dataclasses
import itertools

import numpy as np
import pytest
from oracles import model, tube_gain
from tolerances import COUNTED

from jaxtube.experiments.montecarlo import tube_reach
from sets.tubes import Section

REACHED_FACET = 1e-9
"""Relative; offsets of facets against the exact reach."""

TUBES = ("paper", "hull", "summed", "sequence")


@pytest.fixture(scope="module", autouse=True)
def fewer_samples():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tube_reach, "SAMPLES", 40_000)
        patch.setattr(tube_reach, "PART", 4_000)
        yield


@pytest.fixture(scope="module")
def design(uncertified):
    return uncertified(
        "robust", "reference.duration_s=3", "slip.relative_error=0.2", "noise.lateral_m=0.002"
    )


@pytest.fixture(scope="module")
def found(design):
    return tube_reach.metrics(design, 3)


@pytest.fixture(scope="module")
def vertices(design):
    """A + B K at the four corners of the box of wheel speeds, rebuilt."""
    problem = design.problem
    reference = problem.scenario.reference
    limits = (reference.wheel_speed_min_mps, reference.wheel_speed_max_mps)
    loops = []
    for wheels in itertools.product(limits, repeat=2):
        A, B = model(problem, wheels)
        loops.append(A + B @ tube_gain(design, wheels))
    return loops


def enumerated_reach(design, vertices, normal):
    """Return the largest normal * deviation over all sequences of corners; the first w is moved N -
    1 times."""
    W = design.problem.disturbance_set
    best = -np.inf
    for sequence in itertools.product(vertices, repeat=design.problem.horizon - 1):
        direction = normal
        reach = 0.0
        for loop in sequence:
            reach += W.support(direction)
            direction = direction @ loop
        best = max(best, reach + W.support(direction))
    return best


@pytest.mark.parametrize("tube", TUBES)
def test_no_sampled_deviation_passes_a_facet_and_some_come_close(design, found, tube):
    assert found[tube]["largest_excess"] <= COUNTED
    assert found[tube]["largest_excess"] > -0.05 * design.problem.disturbance_set.offsets.min()


@pytest.mark.parametrize("tube", TUBES)
def test_no_facet_is_short_of_the_exact_reach(found, tube):
    ratio = found[tube]["ratio_to_reach"]
    assert 1 - REACHED_FACET <= ratio["least"] <= ratio["mean"] <= ratio["greatest"]


def test_the_hull_is_exact_and_the_sequence_is_reached(found):
    assert abs(found["hull"]["ratio_to_reach"]["greatest"] - 1) <= REACHED_FACET
    sequence = found["sequence"]
    assert 0.999 <= sequence["least_share_reached"] <= 1 + REACHED_FACET
    assert sequence["least_share_reached"] == 1 / sequence["ratio_to_reach"]["greatest"]


@pytest.mark.parametrize("tube", ["paper", "hull", "summed"])
def test_ratios_are_those_to_the_reach_over_all_sequences(design, found, vertices, tube):
    """Where there are many facets, a dozen of them."""
    section = design.tubes[tube][-1].polytope()
    stride = max(len(section.offsets) // 12, 1)
    reach = [enumerated_reach(design, vertices, normal) for normal in section.normals[::stride]]
    ratios = section.offsets[::stride] / reach
    told = found[tube]["ratio_to_reach"]
    assert told["least"] - REACHED_FACET <= ratios.min()
    assert ratios.max() <= told["greatest"] + REACHED_FACET
    if stride == 1:
        expected = {"least": ratios.min(), "mean": ratios.mean(), "greatest": ratios.max()}
        assert told == pytest.approx(expected, rel=1e-9)
    assert found[tube]["facets"] == len(section.offsets)


class Shrunk:
    """A section a little smaller than it should be."""

    def __init__(self, section: Section):
        self._section = section

    def polytope(self):
        whole = self._section.polytope()
        return dataclasses.replace(whole, offsets=0.97 * whole.offsets)


@pytest.mark.parametrize("tube", ["paper", "hull", "summed"])
def test_a_tube_too_small_is_found_out(design, found, tube):
    sections = [design.tubes[tube][0], *map(Shrunk, design.tubes[tube][1:])]
    smaller = dataclasses.replace(design.tubes[tube], sections=sections)
    tubes = design.tubes | {tube: smaller}
    shrunk = tube_reach.metrics(dataclasses.replace(design, tubes=tubes), 3)
    assert shrunk[tube]["largest_excess"] > 1e-5
    for name, ratio in shrunk[tube]["ratio_to_reach"].items():
        assert ratio == pytest.approx(0.97 * found[tube]["ratio_to_reach"][name], rel=REACHED_FACET)


def test_a_tube_along_the_reference_too_small_is_found_out(design, monkeypatch):
    whole = tube_reach.sequence_tube

    def shrink(loops, W):
        return [*map(Shrunk, whole(loops, W))]

    monkeypatch.setattr(tube_reach, "sequence_tube", shrink)
    found = tube_reach.metrics(design, 3)["sequence"]
    assert found["largest_excess"] > 1e-5
    assert found["ratio_to_reach"]["greatest"] < 0.98


def test_the_table_names_every_tube(found):
    table = tube_reach.table(found)
    first_words = {line.split()[0] for line in table.splitlines()}
    assert first_words >= set(TUBES)
    assert f"{found['sequence']['least_share_reached']:.4%}" in table
