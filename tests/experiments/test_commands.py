"""Laws of the commands `design` and `paper`: exit codes, complete run folders, numbers that are
those computed."""

import dataclasses
import html
import json
import re

import numpy as np
import pytest
from pages import find_first_lines
from PIL import Image
from spoken import leave_out_waits
from tolerances import CLOSED_LOOP, WORLD_FRAME

from jaxtube import storage
from jaxtube.experiments.cli import main
from jaxtube.experiments.design import command
from jaxtube.experiments.run.exit_codes import exit_code
from jaxtube.scenario import ScenarioError, load, replace
from jaxtube.simulation import batches, components
from jaxtube.synthesis.design import design as compute
from jaxtube.synthesis.design import refuse_infeasible_start, refuse_start_outside_limits
from jaxtube.synthesis.optimum import Optimum
from jaxtube.synthesis.problem import make_problem
from jaxtube.synthesis.proof_file import FILE
from jaxtube.synthesis.proof_search import PROGRAMS
from sets.certificate import Certificate, Condition

REALISATIONS = 4
CONTROLLERS = {"uncompensated", "compensated", "local_gain", "equal_gain", "plain_mpc", "tube_mpc"}
TUBES = {"paper", "hull", "summed", "sequence"}
FIGURES = {"trajectories", "errors", "wheel_speeds", "margins", "stress", "realisations_in_tube"}
FIGURES |= {"tube_sections", "tightened_sets", "terminal_set", "stress_terminal_set"}


@pytest.fixture
def known_designs(monkeypatch, certified_paper_design, robust_design):
    """Hand out the session's designs where a scenario differs in its start at most."""

    def design(scenario, options=None):
        for known in (certified_paper_design, robust_design):
            same = known.problem.scenario
            if replace(scenario, {"initial": same.initial}) == same:
                return dataclasses.replace(known, problem=make_problem(scenario))
        return compute(scenario)

    monkeypatch.setattr("jaxtube.experiments.design.command.make_design", design)
    monkeypatch.setattr("jaxtube.experiments.paper.command.make_design", design)
    monkeypatch.setattr("jaxtube.experiments.paper.drawings.make_design", design)


def run(folder, *words):
    return main([*words, "--out", str(folder)])


def metrics_of(folder):
    return json.loads((folder / "metrics.json").read_text())


def refusal(capsys):
    output = capsys.readouterr()
    assert output.out == ""
    (line,) = leave_out_waits(output.err)
    return line


# --------------------------------------------------------------------------------------- exit codes


OUTSIDE = ("initial.y_m=-0.29", "initial.heading_deg=-15")


def test_a_start_outside_the_feasible_set_ends_paper_with_2_and_leaves_no_folder(
    tmp_path, capsys, known_designs
):
    assert run(tmp_path / "run", "paper", "--scenario", "robust", *OUTSIDE) == 2
    assert "outside the feasible set" in refusal(capsys)
    assert not (tmp_path / "run").exists()


def test_a_start_outside_the_feasible_set_does_not_hide_the_design(tmp_path, capsys, known_designs):
    assert run(tmp_path / "run", "design", "--scenario", "robust", *OUTSIDE) == 2
    output = capsys.readouterr()
    assert "plan_stays_feasible" in output.out
    assert "CERTIFIED for the linear model" in output.out
    (line,) = leave_out_waits(output.err)
    assert "outside the feasible set" in line
    found = metrics_of(tmp_path / "run")
    assert found["certified_for_model"]
    assert "disturbance" not in found
    assert (tmp_path / "run" / "sets.png").exists()
    assert load(tmp_path / "run" / "scenario.toml") == load("robust", OUTSIDE)


@pytest.mark.parametrize(
    ("words", "overrides", "limits"),
    [
        (
            ["design", "--scenario", "certified"],
            ["initial.x_m=0.2", "initial.y_m=-0.5", "initial.heading_deg=12"],
            "certified",
        ),
        (["paper"], ["initial.y_m=0.31", "initial.heading_deg=-19"], "paper"),
        (["design", "--optimise"], ["initial.heading_deg=100"], "paper"),
    ],
)
def test_a_start_outside_the_limits_is_refused_before_any_design(
    words, overrides, limits, tmp_path, capsys, monkeypatch
):
    monkeypatch.delattr("jaxtube.experiments.design.command.make_design")
    monkeypatch.delattr("jaxtube.experiments.design.command.optimise")
    monkeypatch.delattr("jaxtube.experiments.paper.command.make_design")
    assert run(tmp_path / "run", *words, *overrides) == 2
    line = refusal(capsys)
    assert "outside [constraints] or [operating]" in line
    assert not (tmp_path / "run").exists()
    refuse_start_outside_limits(make_problem(load(limits, cure_of(line))))


def test_the_start_that_a_refusal_names_has_a_plan(robust_design):
    heading = "initial.heading_deg=-15"
    scenario = load("robust", [OUTSIDE[0], heading])
    elsewhere = dataclasses.replace(robust_design, problem=make_problem(scenario))
    with pytest.raises(ScenarioError, match="outside the feasible set") as refused:
        refuse_infeasible_start(elsewhere)
    mended = make_problem(load("robust", cure_of(str(refused.value))))
    refuse_infeasible_start(dataclasses.replace(robust_design, problem=mended))


def cure_of(line):
    """Return the overrides that a refused start is mended by."""
    pose = line.split("% as far away: ")[1].split(";")[0]
    return [key.strip().replace(" = ", "=") for key in pose.split(", ")]


def test_an_optimised_design_outlives_a_start_without_a_plan(
    tmp_path, capsys, known_designs, monkeypatch
):
    """The search takes minutes: what it found can be run from the folder."""
    found = load("robust", OUTSIDE)
    optimum = Optimum(found, 0.5, 1.0, {}, {})
    monkeypatch.setattr(command, "find_caps_and_gains", lambda scenario, options: optimum)
    assert run(tmp_path, "design", "--optimise", *OUTSIDE) == 2
    assert "caps and gains found" in (tmp_path / "report.txt").read_text()
    assert load(tmp_path / "scenario.toml") == found
    assert metrics_of(tmp_path)["certified_for_model"]


@pytest.mark.parametrize("command", ["design", "paper"])
def test_an_empty_tightened_set_ends_with_3_and_leaves_no_folder(command, tmp_path, capsys):
    assert run(tmp_path / "run", command, "--disturbance.lateral_m", "0.2") == 3
    assert refusal(capsys).startswith("E_2 is empty")
    assert not (tmp_path / "run").exists()


def test_a_failed_certificate_is_reported_and_ends_with_3_only_on_request(
    tmp_path, capsys, known_designs, certified_paper_design
):
    assert run(tmp_path, "design") == 0
    assert run(tmp_path, "design", "--require-certificate") == 3
    found = metrics_of(tmp_path)
    assert not found["certified"]
    assert not found["certified_for_model"]
    assert not found["certificate"]["disturbance_bound_proved"]["holds"]
    assert "disturbance_in_w" not in found["certificate"]
    assert not found["disturbance"]["every_w_inside"]
    text = capsys.readouterr().out
    assert "certificate (terminal paper, tube paper)" in text
    assert "NOT CERTIFIED: plan_stays_feasible" in text
    for name, condition in found["certificate"].items():
        assert name in text
        assert condition["sentence"].split()[-1] in text


def test_a_certificate_that_holds_for_the_robot_meets_the_request():
    for margin, required, code in ((0.0, True, 0), (-1.0, False, 0), (-1.0, True, 3)):
        certificate = Certificate((Condition("condition", margin, "", "robot"),))
        assert exit_code(certificate, required) == code
    of_model_alone = Certificate((Condition("condition", 0.0, ""),))
    assert exit_code(of_model_alone, True) == 3


def test_simulated_laps_refute_that_w_lies_in_W_and_never_prove_it(tmp_path):
    """A real design from the command line, small: slip that is known exactly leaves only what was
    linearised."""
    words = ("design", "--scenario", "robust", "--require-certificate")
    overrides = (
        "controller.horizon=2",
        "reference.wheel_speed_min_mps=1.2",
        "slip.relative_error=0",
        "initial.x_m=0",
        "initial.y_m=0.01",
        "disturbance.lateral_m=0.01",
        "disturbance.longitudinal_m=0.01",
    )
    assert run(tmp_path, *words, *overrides) == 3
    found = metrics_of(tmp_path)
    required = {name: c for name, c in found["certificate"].items() if c["required"]}
    failing = [name for name, condition in required.items() if not condition["holds"]]
    assert failing == ["disturbance_bound_proved"]
    assert found["disturbance"]["share_of_steps_outside"] == 0
    assert found["disturbance"]["margin"] >= 0


# ------------------------------------------------------------------------------------------- design


def check_design_metrics(found, design):
    np.testing.assert_allclose(found["lqr_gain"], design.lqr_gain, rtol=CLOSED_LOOP)
    for key in ("tube_half_widths", "tube_volume", "input_support"):
        assert set(found[key]) == TUBES
    N = design.problem.horizon
    assert {np.shape(widths) for widths in found["tube_half_widths"].values()} == {(N + 1, 3)}
    assert {np.shape(support) for support in found["input_support"].values()} == {(N + 1,)}
    assert np.shape(found["input_set_p_q"]) == (2, 2)
    assert np.shape(found["terminal_gains"]) == (4, 2, 3)
    np.testing.assert_allclose(found["lmi_cost"], design.cost.cost, rtol=CLOSED_LOOP)
    assert found["terminal_facets"] == len(design.terminal.invariant.offsets)
    assert len(found["terminal_half_widths"]) == 3
    assert set(design.certificate.conditions) == set(found["certificate"])
    assert all(seconds >= 0 for seconds in found["design_seconds"].values())


def test_the_design_command_writes_what_was_designed(
    tmp_path, capsys, known_designs, robust_design
):
    assert run(tmp_path, "design", "--scenario", "robust") == 0
    found = metrics_of(tmp_path)
    check_design_metrics(found, robust_design)
    steps = robust_design.problem.reference.steps
    assert found["disturbance"]["steps"] == batches.BATCH * steps
    assert {path.name for path in tmp_path.iterdir()} == {
        "laps.npz",
        "metrics.json",
        "manifest.json",
        "report.html",
        "report.txt",
        "scenario.toml",
        "sets.pdf",
        "sets.png",
        "design",
        FILE,
        *PROGRAMS,
    }
    kept = storage.read_result(tmp_path / "design")
    assert kept.scenario == robust_design.problem.scenario
    for name, array in robust_design.arrays().items():
        assert kept.arrays[name].tobytes() == array.tobytes(), name
    text = capsys.readouterr().out
    assert text.startswith((tmp_path / "report.txt").read_text())
    for words in ("* summed", f"{found['terminal_facets']} facets", str(tmp_path)):
        assert words in text
    check_page(tmp_path, {"sets"}, robust_design)


def check_page(folder, figures, design):
    """The page tells all conditions, what is assumed and the printed text, and shows all figures in
    words, too."""
    text = (folder / "report.html").read_text()
    verdict, printed = find_first_lines(folder)
    assert verdict == printed
    assert len(text.encode()) < 5e6
    told = html.unescape(text)
    for condition in design.certificate.checked:
        assert condition.sentence in told
    for assumption in design.certificate.assumptions:
        assert assumption in told
    assert (folder / "report.txt").read_text() in told
    pictures = re.findall(
        r'<img src="data:image/(?:webp|png);base64,[^"]+" [^>]*alt="([^"]{40,})"', text
    )
    assert len(pictures) == len(figures)
    assert {name for name in figures if f"<b>{name}</b>" in text} == figures
    assert json.loads((folder / "manifest.json").read_text())["command_line"] in told


def test_a_design_is_drawn_again_in_another_style(tmp_path, capsys, known_designs):
    assert run(tmp_path, "design", "--scenario", "robust") == 0
    style = tmp_path / "thesis.mplstyle"
    style.write_text("figure.figsize: 5, 3\nfont.size: 7\n")
    assert main(["figures", str(tmp_path), "--style", str(style)]) == 0
    redrawn = tmp_path / "figures-thesis"
    assert {path.name for path in redrawn.iterdir()} == {"sets.png", "sets.pdf"}
    with Image.open(tmp_path / "sets.png") as usual, Image.open(redrawn / "sets.png") as styled:
        assert styled.width == 5 * 200 < usual.width
        assert styled.height / styled.width == pytest.approx(usual.height / usual.width, abs=0.01)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["{run}"], "--style"),
        (["{run}", "--style", "no-such-style"], "is no style of matplotlib; name a file"),
        (["{run}", "--style", "ggplot", "controller.horizon=7"], "is of no use here"),
        (["{run}/none", "--style", "ggplot"], "holds no complete run; name the folder"),
        (["{beyond}", "--style", "ggplot"], "is a run of beyond; figures can be drawn again of"),
    ],
)
def test_what_cannot_be_drawn_again_is_refused_in_one_line(tmp_path, capsys, words, told):
    for name in ("run", "beyond"):
        (tmp_path / name).mkdir()
        line = {"command_line": f"python -m jaxtube.experiments {name.replace('run', 'design')}"}
        (tmp_path / name / "manifest.json").write_text(json.dumps(line))
        (tmp_path / name / "scenario.toml").write_text("")
    folders = {name: str(tmp_path / name) for name in ("run", "beyond")}
    assert main(["figures", *(word.format(**folders) for word in words)]) == 2
    assert told in refusal(capsys)


# -------------------------------------------------------------------------------------------- paper


@pytest.fixture(scope="module")
def paper_run(tmp_path_factory, certified_paper_design, robust_design):
    """(exit code, folder, metrics) of `paper` with few realisations."""
    pytest.importorskip("jaxtube.figures.laps")
    pytest.importorskip("jaxtube.figures.sets")
    folder = tmp_path_factory.mktemp("paper")
    with pytest.MonkeyPatch.context() as patch:

        def design(scenario, options=None):
            known = (
                robust_design if scenario.controller.tube == "summed" else certified_paper_design
            )
            assert known.problem.scenario == scenario
            return known

        patch.setattr("jaxtube.experiments.paper.command.make_design", design)
        patch.setattr("jaxtube.experiments.paper.drawings.make_design", design)
        code = run(folder, "paper", "--realisations", str(REALISATIONS))
    return code, folder, metrics_of(folder)


@pytest.mark.slow
def test_the_paper_command_writes_every_file(paper_run):
    code, folder, _ = paper_run
    assert code == 0
    names = {f"{name}.{kind}" for name in FIGURES for kind in ("png", "pdf")}
    names |= {"metrics.json", "manifest.json", "scenario.toml", "report.txt", "report.html"}
    names |= {"laps.npz", "noise_free.npz", "deviations.npz", "stress.npz"}
    assert {path.name for path in folder.iterdir()} == names
    assert all(path.stat().st_size > 0 for path in folder.iterdir())


@pytest.mark.slow
def test_the_page_of_the_paper_command_tells_claims_first(paper_run, certified_paper_design):
    _, folder, found = paper_run
    check_page(folder, FIGURES, certified_paper_design)
    text = re.sub("</?code>", "`", (folder / "report.html").read_text())
    told = html.unescape(text)
    counted = sum(row["verdict"] == "reproduced" for row in found["claims"])
    assert re.search(rf"<h1[^>]*>{counted} of the paper.{{1,8}}s 13 claims are reproduced, ", told)
    for row in found["claims"]:
        assert row["claim"] in told and row["measured"] in told


@pytest.mark.slow
def test_the_figures_of_the_paper_command_are_drawn_again(paper_run, tmp_path):
    _, folder, _ = paper_run
    words = ["--style", "ggplot", "--out", str(tmp_path)]
    assert main(["figures", str(folder), *words]) == 0
    names = {f"{name}.{kind}" for name in FIGURES for kind in ("png", "pdf")}
    assert {path.name for path in tmp_path.iterdir()} == names


@pytest.mark.slow
def test_the_metrics_of_the_paper_command_are_complete(paper_run, certified_paper_design):
    _, _, found = paper_run
    check_design_metrics(found, certified_paper_design)
    steps = certified_paper_design.problem.reference.steps
    assert set(found["controllers"]) == CONTROLLERS
    for numbers in found["controllers"].values():
        assert numbers["realisations"] == REALISATIONS
        assert 0 <= numbers["violation_share"] <= 1
        assert 0 <= numbers["active_share"] <= 1
        for kind in ("max_error", "rms_error"):
            assert set(numbers[kind]) == {"whole_run", "after_10_s"}
            for spread in numbers[kind].values():
                assert set(spread) == {"median", "p95", "worst"}
        assert 1 < numbers["wheel_speed_max_mps"] <= 3
        assert numbers["qp_status"] == {
            "solved": REALISATIONS * steps,
            "infeasible": 0,
            "unsolved": 0,
        }
    assert found["other_restart"]["restart"] is False
    assert found["disturbance"]["steps"] == REALISATIONS * steps
    assert found["plan_deviations"]["samples"] > 0
    verdicts = [row["verdict"] for row in found["claims"]]
    assert len(verdicts) == 13
    assert set(verdicts) >= {"reproduced", "not reproduced"}


@pytest.mark.slow
def test_the_laps_behind_the_figures_are_saved(paper_run, certified_paper_design):
    _, folder, found = paper_run
    steps = certified_paper_design.problem.reference.steps
    shapes = {"errors": (steps + 1, REALISATIONS, 3), "inputs": (steps, REALISATIONS, 2)}
    shapes["wheels"] = shapes["inputs"]
    with np.load(folder / "laps.npz") as laps:
        assert set(laps["controllers"]) == CONTROLLERS
        for name in CONTROLLERS:
            for kind, shape in shapes.items():
                assert laps[f"{name}_{kind}"].shape == shape
        fastest = np.abs(laps["tube_mpc_wheels"]).max()
    assert fastest == pytest.approx(found["controllers"]["tube_mpc"]["wheel_speed_max_mps"])


@pytest.mark.slow
def test_under_stress_on_the_linear_plant_the_guarantee_holds(paper_run):
    _, _, found = paper_run
    assert found["stress_design"] == "robust"
    tube = found["stress"]["linear_w_in_W"]["tube_mpc"]
    plain = found["stress"]["linear_w_in_W"]["plain_mpc"]
    assert tube["runs"] == tube["runs_with_every_w_in_W"] == 40 * REALISATIONS
    assert tube["runs_outside_E"] == tube["infeasible_QPs"] == tube["unsolved_QPs"] == 0
    assert plain["runs_outside_E"] > 0
    for runs in found["stress"].values():
        assert runs["tube_mpc"]["runs_outside_E_with_every_w_in_W"] == 0


@pytest.mark.slow
def test_the_design_of_another_scenario_is_itself_put_under_stress(
    tmp_path, capsys, known_designs, robust_design
):
    assert run(tmp_path, "paper", "--scenario", "robust", "--realisations", "1") == 0
    found = metrics_of(tmp_path)
    assert found["stress_design"] == "robust"
    assert set(found["stress_certificate"]) == set(robust_design.certificate.conditions)
    assert "under stress: design `robust`" in capsys.readouterr().out
    assert not (tmp_path / "stress_terminal_set.png").exists()


@pytest.mark.slow
def test_the_noise_free_laps_are_the_ones_with_exact_slip(paper_run, certified_paper_design):
    _, folder, _ = paper_run
    with np.load(folder / "noise_free.npz") as laps:
        assert set(laps) == {"uncompensated", "compensated", "tube_mpc", "plain_mpc"}
        for name in laps:
            assert laps[name].shape == (301, 3)
            np.testing.assert_array_equal(
                laps[name][0], certified_paper_design.problem.initial_error
            )
        controller = components.controllers(certified_paper_design)["tube_mpc"]
        plant = components.exact_robot(certified_paper_design)
        start = certified_paper_design.problem.initial_error[None]
        lap = batches.run_realisations(controller, plant, start, 0).errors[:, 0]
        np.testing.assert_allclose(laps["tube_mpc"], lap, atol=WORLD_FRAME)
        assert np.abs(laps["tube_mpc"][-1]).max() < 0.01 < np.abs(laps["uncompensated"]).max()
