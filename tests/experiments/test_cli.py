"""Laws of the command line: exit codes, one line for bad input, complete run folders, claims really
compared."""

import dataclasses
import importlib.metadata
import io
import json
import math
import os
import shlex
import subprocess
import sys
from types import ModuleType

import numpy as np
import pytest

from jaxtube.experiments import options as command_options
from jaxtube.experiments.check import MISSING, Metric, holds, resolve
from jaxtube.experiments.cli import main, parse
from jaxtube.experiments.run import folder as run_folder
from jaxtube.scenario import Scenario, load

# The fake design writes this; the claims of the tests are made against it.
METRICS = {
    "half_widths_m": [[0.0], [0.5, 0.25]],
    "terminal": {"facets": 269, "exists": True},
    "volume": float("nan"),
}


def replace_module(monkeypatch, name: str, **contents) -> None:
    module = ModuleType(name)
    vars(module).update(contents)
    monkeypatch.setitem(sys.modules, name, module)


@pytest.fixture
def fake_runs(monkeypatch):
    """Replace the design and the paper run by ones that write METRICS; returns the options each was
    run with."""
    calls = []

    def run(scenario, options):
        calls.append((scenario, options))
        run_folder.create(scenario, options).save_metrics(METRICS)
        return 0

    for name in ("design", "paper"):
        replace_module(monkeypatch, f"jaxtube.experiments.{name}.command", run=run)
    return calls


@pytest.fixture
def empty_set_error(monkeypatch):
    error = type("EmptySetError", (ValueError,), {})
    replace_module(monkeypatch, "jaxtube.synthesis.design", EmptySetError=error)
    return error


def error_line(capsys, *words) -> str:
    """Run a command that must end with bad input, and return the one line that it says."""
    assert main(words) == 2
    output = capsys.readouterr()
    assert output.out == "" and output.err.count("\n") == 1
    return output.err


# -------------------------------------------------------------------------------------------- words


def test_the_default_command_is_the_paper():
    assert parse([]) == parse(["paper"]) == command_options.PaperOptions()
    assert parse(["--realisations", "32"]) == command_options.PaperOptions(realisations=32)


def test_the_three_forms_of_an_override_are_one():
    for words in (
        ["controller.horizon=7"],
        ["--controller.horizon=7"],
        ["--controller.horizon", "7"],
    ):
        assert parse(["design", *words, "--seed", "3"]) == command_options.DesignOptions(
            seed=3, overrides=("controller.horizon=7",)
        )
    assert parse(["--initial.x_m", "-0.1"]) == command_options.PaperOptions(
        overrides=("initial.x_m=-0.1",)
    )


def test_the_written_command_line_reads_back_as_the_same_options():
    words = [
        "check",
        "a",
        "b c.toml",
        "--seed",
        "3",
        "--quick",
        "--out",
        "some where",
        "controller.horizon=7",
    ]
    options = parse(words)
    assert options is not None
    written = shlex.split(command_options.command_line(options))
    assert parse(written[written.index("check") :]) == options


@pytest.mark.parametrize(
    ("scenario", "title"),
    [("paper", "paper"), ("a/mine.toml", "mine"), ("wet/scenario.toml", "wet")],
)
def test_the_folder_of_a_run_is_named_after_command_and_scenario(scenario, title):
    assert str(command_options.DesignOptions(scenario=scenario).folder) == f"runs/design-{title}"
    assert str(command_options.DesignOptions(scenario=scenario, out="here").folder) == "here"


@pytest.mark.parametrize(
    ("words", "fragments"),
    [
        (
            ["papr"],
            [
                "papr",
                "paper, design, montecarlo, falsify, guarantee, fit, maps, coverage, beyond, path, "
                "tune, identify, replay, export, bench, animate, figures, list, check, doctor, "
                "completion",
            ],
        ),
        (["desing"], ["did you mean design?"]),
        (["design", "controller.horizon", "7"], ["; write controller.horizon=7;"]),
        (["design", "controller.horizon"], ["; write controller.horizon=VALUE;"]),
        (["design", "--horizon", "7"], ["; write controller.horizon=7;"]),
        (["design", "--seed", "3", "--dt-s=0.2"], ["; write controller.dt_s=0.2;"]),
        (["montecarlo", "--realisations", "1e30"], ["--realisations = 1e+30", "from 1 to 2^53"]),
        (["design", "--radius-m", "3"], ["; write reference.radius_m=3;"]),
        (["design", "--lateral-m", "3"], ["; write constraints.lateral_m=3 or operating."]),
        (["paper", "else"], ["else"]),
        (["--seeed", "3"], ["--seeed", "did you mean --seed?"]),
        (["--seed"], ["--seed"]),
        (["--seed", "three"], ["--seed", "three"]),
        (["--seed", "-1"], ["--seed = -1", "from 0"]),
        (["--realisations", "0"], ["--realisations = 0", "from 1 to 2^53", "such as 1000"]),
        (["montecarlo", "--realisations", "2.5"], ["--realisations = 2.5", "whole number"]),
        (["montecarlo", "--replay", "-5"], ["--replay = -5", "from 0"]),
        (["montecarlo", "--replay", str(2**64)], ["--replay = 18446744073709551616", "2^64"]),
        (["tune", "--learning-rate", "nan"], ["--learning-rate = nan", "positive"]),
        (["bench", "--seconds", "0"], ["--seconds = 0", "positive number"]),
        (["design", "controller.tube=\udcff"], [r"controller.tube=\udcff", "UTF-8"]),
        (["design", "--out", "a\udcff"], [r"a\udcff", "UTF-8"]),
        (["design", "--realisations", "3"], ["--realisations"]),
        (["maps", "--points", "1"], ["--points = 1", "from 2"]),
        (["maps", "--scenario", "paper"], ["operating", "no caps", "--scenario certified"]),
        (["--scenario", "no-such"], ['"no-such"', "choose one of", "paper"]),
        (["--scenario", "no-such.toml"], ["no-such.toml", "No such file"]),
        (["--controller.horizon", "0"], ["controller.horizon = 0", "whole number >= 1"]),
        (["--controller.horizon"], ["controller.horizon", "no value"]),
        (["list", "controller.tube=cone"], ["controller.tube", "choose one of"]),
        (["check", "no-such"], ['"no-such"', "choose one of"]),
    ],
)
def test_bad_input_ends_with_2_and_one_line_that_names_it(words, fragments, capsys):
    line = error_line(capsys, *words)
    assert [fragment for fragment in fragments if fragment not in line] == []


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("montecralo", "did you mean montecarlo?"),
        ("design --secnario paper", "did you mean --scenario?"),
        ("design --optimize", "did you mean --optimise?"),
        ("design --horizn 7", "write controller.horizon=7"),
        ("design --realisations 4", "it is one of paper, montecarlo, guarantee, beyond"),
        ("doctor --quick", "it is one of bench, check"),
        ("design --scenario certifed", "did you mean certified?"),
        ("design --scenario certified.toml", "did you mean certified?"),
        ("check certifed", "did you mean certified?"),
        ("guarantee --against certifed", 'scenario: name = "certifed"'),
        ("design robust", "write --scenario robust"),
        ("montecarlo --controller tube-mpc", "did you mean tube_mpc?"),
        ("fit sped", "did you mean speed?"),
        ("design horizn=7", "did you mean controller.horizon?"),
        ("design controller.horizn=7", "did you mean controller.horizon?"),
        ("design controler.horizon=7", "did you mean controller.horizon?"),
        ("design contraints.lateral_m=3", "did you mean constraints.lateral_m?"),
        ("design lateral_m=3", "did you mean constraints.lateral_m or operating.lateral_m or"),
        ("design controller.terminal=T-X", "did you mean T-A or T-B?"),
        ("design slip.process=Walk", "did you mean walk?"),
        ("design controller.zzz=1", "the keys of [controller] are dt_s, horizon"),
    ],
)
def test_a_typing_error_is_answered_with_what_was_meant(typed, meant, capsys):
    assert meant in error_line(capsys, *typed.split())


def test_nothing_is_suggested_for_what_is_near_to_nothing(capsys):
    for typed in ("xyzzy", "design --qqqq", "design qqqq.zzzz=1", "design --scenario qqqq"):
        assert "did you mean" not in error_line(capsys, *typed.split())


def test_an_out_folder_that_cannot_be_is_bad_input(tmp_path, capsys, fake_runs):
    (tmp_path / "file").write_text("")
    assert "is a file" in error_line(capsys, "design", "--out", str(tmp_path / "file"))
    assert "cannot be written to" in error_line(
        capsys, "design", "--out", str(tmp_path / "file" / "below")
    )


def test_help_in_a_narrow_terminal_ends(tmp_path):
    """In a few columns the parser would take gigabytes and minutes."""
    limit = "import resource; resource.setrlimit(resource.RLIMIT_AS, (2**32, 2**32)); "
    code = limit + "from jaxtube.experiments.cli import main; main(['design', '--help'])"
    environment = os.environ | {"COLUMNS": "5"}
    help = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=60
    )
    assert help.returncode == 0 and "usage:" in help.stdout
    assert max(map(len, help.stdout.splitlines())) > 30


def test_an_error_line_never_raises(monkeypatch, empty_set_error):
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii", errors="strict")
    monkeypatch.setattr(sys, "stderr", stream)
    fail_with(monkeypatch, empty_set_error("s\u00b2 and \udcff"))
    assert main(["design"]) == 3
    stream.flush()
    assert stream.buffer.getvalue() == b"s\\xb2 and \\udcff\n"


@pytest.mark.parametrize("words", [["--help"], ["-h"], ["paper", "--help"], ["check", "--help"]])
def test_help_ends_with_0(words, capsys):
    assert main(words) == 0
    assert "usage: python -m jaxtube.experiments" in capsys.readouterr().out


HEAVY = ("jax", "numpy", "scipy", "matplotlib", "sets", "highspy", "clarabel", "msgspec", "tqdm")


@pytest.mark.parametrize(
    ("words", "needed"),
    [
        (["--help"], ()),
        (["montecarlo", "--help"], ()),
        (["completion", "bash"], ("numpy", "msgspec", "tqdm")),
        (["--complete", "jaxtube des"], ("numpy", "msgspec")),
        (["--complete", "jaxtube montecarlo --controller pl"], ()),
        (["list"], ("numpy", "msgspec", "scipy", "sets", "highspy", "clarabel")),
    ],
)
def test_words_that_compute_nothing_import_nothing_heavy(words, needed):
    code = (
        "import sys; from jaxtube.experiments import __main__\n"
        f"assert __main__.main({words}) == 0\n"
        f"heavy = (set({HEAVY}) - set({needed})) & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr


# --------------------------------------------------------------------------------------- exit codes


@pytest.mark.parametrize("code", [0, 3])
def test_the_exit_code_is_that_of_the_command(code, monkeypatch):
    replace_module(
        monkeypatch, "jaxtube.experiments.design.command", run=lambda scenario, options: code
    )
    assert main(["design"]) == code


def fail_with(monkeypatch, error: BaseException) -> None:
    def run(scenario, options):
        raise error

    replace_module(monkeypatch, "jaxtube.experiments.design.command", run=run)


def test_an_empty_set_ends_with_3_and_its_line(monkeypatch, capsys, empty_set_error):
    fail_with(monkeypatch, empty_set_error("E_4 is empty by 0.02 m"))
    assert main(["design"]) == 3
    assert capsys.readouterr().err == "E_4 is empty by 0.02 m\n"


def test_an_interruption_ends_with_4_and_one_line(monkeypatch, capsys):
    fail_with(monkeypatch, KeyboardInterrupt())
    assert main(["design"]) == 4
    assert capsys.readouterr().err.count("\n") == 1


def test_a_fault_of_the_program_keeps_its_traceback(monkeypatch, empty_set_error):
    fail_with(monkeypatch, ValueError("a fault"))
    with pytest.raises(ValueError, match="a fault"):
        main(["design"])


def test_an_interrupted_process_ends_at_once_with_4(tmp_path):
    """Also where a thread that nobody can stop is still at work, as that of a device is."""
    (tmp_path / "jaxtube_probe.py").write_text(
        "import sys, threading, time, types\n"
        "module = types.ModuleType('design')\n"
        "def run(scenario, options):\n"
        "    threading.Thread(target=time.sleep, args=(60,)).start()\n"
        "    raise KeyboardInterrupt\n"
        "module.run = run\n"
        "sys.modules['jaxtube.experiments.design.command'] = module\n"
        "sys.argv = ['jaxtube.experiments', 'design']\n"
        "import runpy\n"
        "runpy.run_module('jaxtube.experiments', run_name='__main__', alter_sys=True)\n"
    )
    command = [sys.executable, tmp_path / "jaxtube_probe.py"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=50)
    assert ended.returncode == 4
    assert ended.stderr == "interrupted; run the same command again\n"


def test_an_interrupt_that_is_swallowed_ends_the_process_all_the_same(tmp_path):
    """As by a callback of a library; a compiled program that cannot be interrupted is alike."""
    (tmp_path / "jaxtube_probe.py").write_text(
        "import os, signal, sys, time, types\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "module = types.ModuleType('design')\n"
        "def run(scenario, options):\n"
        "    try:\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n"
        "        time.sleep(1)\n"
        "    except KeyboardInterrupt:\n"
        "        time.sleep(60)\n"
        "module.run = run\n"
        "sys.modules['jaxtube.experiments.design.command'] = module\n"
        "sys.argv = ['jaxtube.experiments', 'design']\n"
        "import runpy\n"
        "runpy.run_module('jaxtube.experiments', run_name='__main__', alter_sys=True)\n"
    )
    command = [sys.executable, tmp_path / "jaxtube_probe.py"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=50)
    assert ended.returncode == 4
    assert ended.stderr == "interrupted; run the same command again\n"


def test_the_process_computes_in_float64_and_ends_with_the_exit_code(tmp_path):
    (tmp_path / "jaxtube_probe.py").write_text(
        "import sys, types\n"
        "module = types.ModuleType('design')\n"
        "def run(scenario, options):\n"
        "    import jax.numpy\n"
        "    return 3 if jax.numpy.zeros(1).dtype == 'float64' else 1\n"
        "module.run = run\n"
        "sys.modules['jaxtube.experiments.design.command'] = module\n"
        "sys.argv = ['jaxtube.experiments', 'design']\n"
        "import runpy\n"
        "runpy.run_module('jaxtube.experiments', run_name='__main__', alter_sys=True)\n"
    )
    assert (
        subprocess.run(
            [sys.executable, tmp_path / "jaxtube_probe.py"], capture_output=True
        ).returncode
        == 3
    )


# --------------------------------------------------------------------------------------- run folder


def test_a_run_folder_says_what_was_asked_and_what_came_out(tmp_path, fake_runs):
    words = ["design", "--out", str(tmp_path / "run"), "--seed", "5", "controller.horizon=7"]
    assert main(words) == 0
    folder = tmp_path / "run"
    assert load(folder / "scenario.toml") == load("paper", ["controller.horizon=7"])
    manifest = json.loads((folder / "manifest.json").read_text())
    assert manifest["seed"] == 5
    assert manifest["command_line"].endswith("controller.horizon=7")
    assert manifest["packages"]["numpy"] == np.__version__
    assert len(manifest["source_sha256"]["sets"]) == 64
    metrics = json.loads((folder / "metrics.json").read_text())
    assert metrics == {**METRICS, "volume": None}
    assert sorted(path.name for path in folder.iterdir()) == [
        "manifest.json",
        "metrics.json",
        "scenario.toml",
    ]


def test_a_run_that_fails_leaves_the_files_of_the_last_one(tmp_path, monkeypatch, capsys):
    words = ["design", "--out", str(tmp_path)]
    create = run_folder.create

    def succeed(scenario, options):
        folder = create(scenario, options)
        folder.report("certified")
        folder.save_metrics({"a": 1})
        return 0

    def fail(scenario, options):
        create(scenario, options)
        raise KeyboardInterrupt

    replace_module(monkeypatch, "jaxtube.experiments.design.command", run=succeed)
    assert main(words) == 0
    assert capsys.readouterr().out == (tmp_path / "report.txt").read_text() == "certified\n"
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    replace_module(monkeypatch, "jaxtube.experiments.design.command", run=fail)
    assert main([*words, "controller.horizon=7"]) == 4
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    replace_module(monkeypatch, "jaxtube.experiments.design.command", run=succeed)
    assert main([*words, "controller.horizon=7"]) == 0
    assert load(tmp_path / "scenario.toml").controller.horizon == 7


@pytest.mark.parametrize("reads", ["this", "another"])
def test_a_scenario_that_no_run_wrote_is_never_overwritten(reads, tmp_path, capsys, fake_runs):
    mine = "# written by hand\n[controller]\nhorizon = 4\n"
    path = tmp_path / "scenario.toml"
    path.write_text(mine)
    scenario = str(path) if reads == "this" else "paper"
    line = error_line(capsys, "design", "--scenario", scenario, "--out", str(tmp_path))
    assert line.startswith("command line: --out = ")
    assert "would overwrite" in line and "name another folder" in line
    assert path.read_text() == mine
    assert [path.name for path in tmp_path.iterdir()] == ["scenario.toml"]


def test_a_run_goes_on_from_the_scenario_it_wrote_but_does_not_change_it(
    tmp_path, capsys, fake_runs
):
    words = ["design", "--out", str(tmp_path), "--scenario"]
    path = tmp_path / "scenario.toml"
    assert main([*words, "paper"]) == 0
    assert main([*words, str(path)]) == 0
    assert "which it reads" in error_line(capsys, *words, str(path), "controller.horizon=7")
    assert main([*words, "robust"]) == 0


def test_a_run_that_replaces_another_scenario_says_so(tmp_path, capsys, fake_runs):
    words = ["design", "--out", str(tmp_path)]
    assert main(words) == main(words) == 0
    assert capsys.readouterr().err == ""
    assert main([*words, "controller.horizon=7"]) == 0
    assert "python -m jaxtube.experiments design --out" in capsys.readouterr().err
    assert main([*words, "controller.horizon=8"]) == 0
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    assert "replaces the run of another scenario" in line and "controller.horizon=7" in line


def test_the_titles_of_figures_name_overrides():
    options = command_options.DesignOptions(overrides=("controller.horizon=7",))
    assert options.label == "paper with controller.horizon=7"
    assert command_options.DesignOptions().label == "paper"
    many = dataclasses.replace(options, overrides=("controller.horizon=7",) * 9)
    assert len(many.label) < 60


def test_an_optimised_design_has_a_folder_of_its_own():
    options = command_options.DesignOptions(scenario="certified", optimise=True)
    assert str(options.folder) == "runs/design-certified-optimised"
    assert str(dataclasses.replace(options, out="here").folder) == "here"


def test_metrics_are_plain_finite_and_sorted(tmp_path):
    folder = run_folder.create(Scenario(), command_options.DesignOptions(out=str(tmp_path)))
    folder.save_metrics(
        {
            "b": np.float32(0.5),
            "a": {1: np.array([1.0, np.inf])},
            "c": (np.int64(2), np.bool_(True), -math.inf),
        }
    )
    text = (tmp_path / "metrics.json").read_text()
    assert json.loads(text) == {"a": {"1": [1.0, None]}, "b": 0.5, "c": [2, True, None]}
    assert text.index('"a"') < text.index('"b"') < text.index('"c"')
    with pytest.raises(TypeError):
        folder.save_metrics({"a": object()})


def test_a_write_that_fails_leaves_the_earlier_file(tmp_path):
    folder = run_folder.create(Scenario(), command_options.DesignOptions(out=str(tmp_path)))
    folder.save_arrays("states", error=np.arange(3.0))
    with pytest.raises(ValueError):
        folder.save_arrays("states", error=np.array([object()]))
    with np.load(tmp_path / "states.npz") as arrays:
        np.testing.assert_array_equal(arrays["error"], [0, 1, 2])
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []


def test_figures_are_png_and_pdf_and_repeat_bit_by_bit(tmp_path):
    from matplotlib.figure import Figure

    folder = run_folder.create(Scenario(), command_options.DesignOptions(out=str(tmp_path)))
    contents = []
    for _ in range(2):
        figure = Figure()
        figure.add_subplot().plot([0, 1])
        folder.save_figure(figure, "tube")
        contents.append([(tmp_path / f"tube.{kind}").read_bytes() for kind in ("png", "pdf")])
    assert contents[0] == contents[1]
    assert contents[0][0].startswith(b"\x89PNG") and contents[0][1].startswith(b"%PDF")


# ----------------------------------------------------------------------------------- list and check


def test_list_prints_each_scenario_with_its_first_sentence(capsys):
    assert main(["list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith("paper ") and "Gonzalez" in line for line in lines)
    assert max(map(len, lines)) <= 100
    assert main(["list", "--scenario", "certified_20"]) == 0
    words = " ".join(capsys.readouterr().out.split())
    assert words == (
        "certified_20 Certified for the slipping robot and every true slip within 20 % of the "
        "nominal 0.2, over the same wheel speeds as `certified`."
    )


def test_dotted_paths_go_through_tables_and_lists():
    assert resolve(METRICS, "half_widths_m.1.1") == 0.25
    assert resolve(METRICS, "terminal.facets") == 269
    for nowhere in ("half_widths_m.2", "half_widths_m.x", "terminal.facets.0", "none", ""):
        assert resolve(METRICS, nowhere) is MISSING


@pytest.mark.parametrize(
    ("actual", "expected", "tolerance", "verdict"),
    [
        (0.5, 0.5, 0.0, True),
        (0.5, 0.25, 0.25, True),
        (0.5, 0.25, 0.2, False),
        (1, 1.0, 0.0, True),
        (True, 1, 1.0, False),
        (1, True, 1.0, False),
        (None, 0.0, 1.0, False),
        (math.nan, 0.0, math.inf, False),
        (MISSING, 0.0, 1.0, False),
        ([0.5], 0.5, 1.0, False),
        ("yes", "yes", 0.0, True),
        ("yes", "no", 0.0, False),
        (True, True, 0.0, True),
    ],
)
def test_a_claim_holds_within_its_tolerance_and_for_its_own_type_alone(
    actual, expected, tolerance, verdict
):
    assert (
        holds(actual, Metric(path="x", value=expected, tolerance=tolerance, provenance=""))
        is verdict
    )


def write_claims(folder, *claims: str) -> str:
    (folder / "scenario.toml").write_text("")
    (folder / "expected.toml").write_text(
        "".join(f'[[metric]]\n{claim}\nprovenance = "by hand"\n' for claim in claims)
    )
    return str(folder / "scenario.toml")


FACETS = 'path = "terminal.facets"\nvalue = 269'
WIDTH = 'path = "half_widths_m.1.0"\nvalue = 0.5001\ntolerance = 1e-3\ncommand = "paper"'


def check(tmp_path, *words) -> int:
    return main(["check", *words, "--out", str(tmp_path / "out"), "--seed", "9"])


def test_check_replays_the_runs_that_its_claims_need(tmp_path, capsys, fake_runs):
    assert check(tmp_path, write_claims(tmp_path, FACETS, WIDTH), "controller.horizon=7") == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == ["ok", "ok", "2"]
    assert {options.command for _, options in fake_runs} == {"design", "paper"}
    assert {(scenario.controller.horizon, options.seed) for scenario, options in fake_runs} == {
        (7, 9)
    }


def test_check_ends_with_1_when_a_metric_is_off_or_missing(tmp_path, capsys, fake_runs):
    missing = 'path = "terminal.volume"\nvalue = 1.0\ntolerance = 1e9'
    assert (
        check(tmp_path, write_claims(tmp_path, FACETS, FACETS.replace("269", "270"), missing)) == 1
    )
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == [
        "ok",
        "off",
        "off",
        "1",
    ]


def test_quick_check_runs_the_design_alone(tmp_path, capsys, fake_runs):
    assert check(tmp_path, "--quick", write_claims(tmp_path, FACETS, WIDTH)) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == [
        "ok",
        "skipped",
        "1",
    ]
    assert [options.command for _, options in fake_runs] == ["design"]


def test_check_counts_the_metrics_of_a_run_that_ended_badly_as_off(
    tmp_path, monkeypatch, capsys, fake_runs
):
    monkeypatch.setattr(
        sys.modules["jaxtube.experiments.design.command"], "run", lambda scenario, options: 3
    )
    assert check(tmp_path, write_claims(tmp_path, FACETS)) == 1
    assert "exit code 3" in capsys.readouterr().out


@pytest.mark.parametrize(
    "claim",
    [
        'path = "a"',
        'path = "a"\nvalue = nan',
        'path = "a"\nvalue = 1\ntolerance = -1',
        "path = ",
        'pth = "a"',
    ],
)
def test_claims_that_cannot_be_read_are_bad_input(claim, tmp_path, capsys):
    assert "expected.toml: " in error_line(capsys, "check", write_claims(tmp_path, claim))


def test_a_check_without_claims_is_bad_input(tmp_path, capsys):
    (tmp_path / "scenario.toml").write_text("")
    assert "expected.toml" in error_line(capsys, "check", str(tmp_path / "scenario.toml"))


def test_the_version_is_told(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"jaxtube {importlib.metadata.version('jaxtube')}\n"
