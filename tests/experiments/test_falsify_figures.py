"""Figures of worst cases: what a run uses of a limit is drawn where the run lies."""

import dataclasses
import types

import numpy as np
import pytest
from figure_checks import assert_presentable
from tolerances import DRAWN

from jaxtube.falsification.setting import make_lap_limits
from jaxtube.falsification.worst import Worst
from jaxtube.figures.worst import make_strips, make_tracks, worst_run
from jaxtube.figures.worst_section import worst_section
from jaxtube.simulation.usage import Replay, read_values

STEP = 3
"""The worst one of an invented lap, long before it has settled."""


@pytest.fixture(scope="module")
def design(uncertified):
    return uncertified("paper")


@pytest.fixture(scope="module")
def played(design):
    """An invented lap of wheel speeds and inputs that are not about the middle of their limits."""
    generator = np.random.default_rng(7)
    steps = design.problem.reference.steps
    lap = types.SimpleNamespace(
        errors=generator.uniform(-0.1, 0.1, (steps + 1, 1, 3)),
        measured=generator.uniform(-0.1, 0.1, (steps + 1, 1, 3)),
        inputs=generator.uniform(-0.1, 0.2, (steps, 1, 2)),
        demanded=generator.uniform(1.2, 1.9, (steps, 1, 2)),
    )
    return Replay(lap, 1.2 * np.stack([section.vertices()[0] for section in design.tube[1:]]))


def usage_of(limits, name, played):
    """Return how much the lap uses of every facet, step by step, as laps are judged."""
    limit = limits[name]
    normals = np.asarray(limit.normals[0])
    centre = np.asarray(limit.centre)
    values = read_values(name, played)[1 if name == "error" else 0 :]
    room = np.asarray(limit.offsets[0]) - normals @ centre
    return (values - centre) @ normals.T / room


def make_worst(design, name):
    attack = {"true": np.ones((design.problem.reference.steps, 2)), "start": np.zeros((1, 3))}
    when = STEP - 1 if name == "tube" else 0
    return Worst(name, 1.1, -0.1, STEP, 0, when, attack)


@pytest.mark.parametrize(
    ("scenario", "name"),
    [("paper", "error"), ("paper", "input"), ("paper", "wheels"), ("certified", "input")],
)
def test_usage_is_drawn_where_the_run_that_uses_it_lies(scenario, name, uncertified, played):
    design = uncertified(scenario)
    limits = make_lap_limits(design)
    usage = usage_of(limits, name, played)
    for track in make_tracks(design.problem, limits, name, played):
        for facet in track.facets:
            steps = np.arange(len(track.values))[-len(usage) :]
            drawn = track.value_at(usage[:, facet], facet, steps)
            assert drawn == pytest.approx(track.values[steps], abs=DRAWN)


def test_the_coupling_of_inputs_to_errors_has_panels_of_its_own(uncertified, played):
    design = uncertified("certified")
    limits = make_lap_limits(design)
    worst = make_worst(design, "input")
    figure = worst_run(design.problem, limits, worst, played)
    assert_presentable(figure)
    labels = [axes.get_ylabel().replace("\n", " ") for axes in figure.axes]
    assert "coupled cap, outwards [rad/s]" in labels
    assert "coupled cap, inwards [rad/s]" in labels


@pytest.mark.parametrize("name", ["error", "input", "wheels", "tube"])
def test_a_worst_run_is_drawn_with_and_without_what_others_met(name, design, played):
    limits = make_lap_limits(design)
    worst = make_worst(design, name)
    assert_presentable(worst_run(design.problem, limits, worst, played))
    if name == "tube":
        return
    reach = {name: usage_of(limits, name, played)}
    figure = worst_run(design.problem, limits, worst, played, (reach, reach))
    assert_presentable(figure)
    later = reach[name][100 - (1 if name == "error" else 0) :]
    title = figure.axes[0].get_title()
    assert title.startswith("worst: 110 % of the limit at 0.3 s; once settled")
    assert f"settled {100 * later.max():.3g} %" in title


def test_the_facet_is_a_line_where_it_is_seen_edge_on(design, played):
    for facet, normal in enumerate(design.tube[1].polytope().normals):
        worst = dataclasses.replace(make_worst(design, "tube"), facet=facet)
        figure = worst_section(design, worst, played)
        assert_presentable(figure)
        shares = [bar.get_height() for bar in figure.axes[2].patches]
        assert shares == pytest.approx([120.0] * design.problem.horizon)
        assert np.count_nonzero(np.abs(normal) > 1e-9) == 1, "R_1 of this design is a box"
        assert all(len(axes.lines) == 3 for axes in figure.axes[:2])


def test_strips_tell_a_slip_from_where_it_begins():
    attack = {"true": np.zeros((1, 2)), "noise": np.zeros((4, 3))}
    worst = Worst("error", 0.5, 0.5, STEP, 0, 0, attack)
    assert [name for name, _ in make_strips(worst)][:2] == ["slip, right", "slip, left"]
    worst = dataclasses.replace(worst, attack=attack | {"change": np.zeros((4, 2))})
    names = [name for name, _ in make_strips(worst)]
    assert names[:3] == ["first slip, right", "first slip, left", "change of slip, right"]
