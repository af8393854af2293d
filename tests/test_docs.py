"""The documentation keeps up with the code: links lead somewhere, command lines can be read, and
every assumption, command, public name and key has its place. Cells of pages run where the pages are
built."""

import ast
import dataclasses
import importlib
import re
import shlex
import sys
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import pytest

import jaxtube
import sets
from jaxtube.experiments import cli
from jaxtube.experiments.options import COMMANDS, flag
from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.certificate import assumptions

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(path for path in DOCS.rglob("*.md") if "_build" not in path.parts)
TEXTS = [*PAGES, ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
PROGRAM = re.compile(r"(\.venv/bin/)?python -m jaxtube\.experiments\b")
RUNS_ELSEWHERE = re.compile(
    r"python3 -m venv |\.venv/bin/|pip install |cp |dask |git |bash \.ci/run|colcon |ros2 |uv "
)
"""Lines for a shell that are no command of the program: CI runs some, none runs here."""
QUICK = ("list", "path")
"""Commands that run here wherever a page has them; cells of pages run others."""
LEAST_WORDS = 2
"""Of a phrase that has to be found: shorter pieces of a sentence stand everywhere."""


class Block(NamedTuple):
    """A fenced block of a text, and the sentence before it."""

    page: str
    language: str
    text: str
    before: str


def read_blocks(path: Path) -> list[Block]:
    text = path.read_text(encoding="utf-8")
    fences = re.finditer(r"^```([^\n]*)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    return [
        Block(
            str(path.relative_to(ROOT)),
            fence[1].strip(),
            fence[2],
            text[: fence.start()].rstrip().rpartition("\n\n")[2],
        )
        for fence in fences
    ]


BLOCKS = [block for path in TEXTS for block in read_blocks(path)]


def list_shell_lines(block: Block) -> list[str]:
    """Return the lines of a block for a shell, continued ones joined, without comments."""
    joined = block.text.replace("\\\n", " ")
    return [line for line in joined.splitlines() if shlex.split(line, comments=True)]


def read_words(line: str) -> list[str]:
    """Return the words after the program's name of the last command in a line."""
    words = shlex.split(line, comments=True)
    return words[words.index("jaxtube.experiments") + 1 :]


SHELL_LINES = [
    pytest.param(line, id=f"{block.page}: {line[:60]}")
    for block in BLOCKS
    if block.language == "sh"
    for line in list_shell_lines(block)
]
COMMAND_LINES = [line for line in SHELL_LINES if PROGRAM.search(line.values[0])]


def import_extension(name: str) -> ModuleType:
    """Import what builds a page from the code, or skip."""
    pytest.importorskip("sphinx", reason="pip install 'jaxtube[docs]'")
    sys.path.insert(0, str(DOCS / "extensions"))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.pop(0)


def normalise(text: str) -> str:
    """Return a text without the breaks, quotation marks and ellipses of a page."""
    return re.sub(r"[\s>…]+", " ", text)


@pytest.mark.parametrize("path", TEXTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_to_files_that_exist(path):
    text = re.sub(r"^```.*?^```$", "", path.read_text(encoding="utf-8"), flags=re.M | re.S)
    targets = re.findall(r"\]\(\s*([^)\s]+)\)", text)
    files = [target.partition("#")[0] for target in targets if "://" not in target]
    missing = [name for name in files if name and not (path.parent / name).exists()]
    assert missing == []


def test_every_page_is_reached_from_the_index():
    index = (DOCS / "index.md").read_text(encoding="utf-8")
    listed = {line for line in index.splitlines() if line and (DOCS / f"{line}.md").exists()}
    pages = {str(path.relative_to(DOCS).with_suffix("")) for path in PAGES}
    assert listed == pages - {"index"}


@pytest.mark.parametrize("line", COMMAND_LINES)
def test_command_lines_can_be_read(line):
    words = read_words(line)
    if "--help" not in words:
        assert cli.parse(words) is not None


@pytest.mark.parametrize("line", SHELL_LINES)
def test_lines_for_a_shell_are_of_the_program_or_known_to_run_elsewhere(line):
    assert PROGRAM.search(line) or RUNS_ELSEWHERE.match(line)


def test_quick_commands_of_the_pages_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "experiments").symlink_to(ROOT / "experiments")
    lines = [line.values[0] for line in COMMAND_LINES]
    quick = {tuple(words) for words in map(read_words, lines) if words and words[0] in QUICK}
    assert {words[0] for words in quick} == set(QUICK)
    for words in sorted(quick):
        assert cli.main(list(words)) == 0, words
    capsys.readouterr()


@pytest.mark.parametrize(
    "block", [block for block in BLOCKS if block.language == "python"], ids=lambda block: block.page
)
def test_python_that_no_build_runs_can_be_read_and_says_so(block):
    ast.parse(block.text)
    if block.page.startswith("docs/"):
        follows = (ROOT / block.page).read_text(encoding="utf-8").partition(block.text)[2]
        nearby = normalise(block.before + follows[:200]).lower()
        assert "not run" in nearby


@pytest.mark.slow
@pytest.mark.parametrize("page", ["README.md", "docs/index.md"])
def test_python_on_the_first_page_runs(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (block,) = [each for each in BLOCKS if each.page == page and each.language == "python"]
    exec(compile(block.text, page, "exec"), {})
    assert "CERTIFIED" in capsys.readouterr().out


def list_phrases() -> list[str]:
    """Return every piece of a sentence that an assumption may be made of, from the source of the
    functions that write them."""
    tree = ast.parse(Path(assumptions.__file__).read_text(encoding="utf-8"))
    docstrings = {
        node.body[0].value
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.Module) and isinstance(node.body[0], ast.Expr)
    }
    pieces = [
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and node not in docstrings
    ]
    texts = [normalise(piece).strip(" ;,()") for piece in pieces if isinstance(piece, str)]
    return sorted({text for text in texts if len(text.split()) >= LEAST_WORDS})


@pytest.mark.parametrize("phrase", list_phrases())
def test_every_assumption_has_its_sentence_in_the_guarantee(phrase):
    page = normalise((DOCS / "guarantee.md").read_text(encoding="utf-8"))
    assert phrase in page


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_is_shown_in_use(command):
    shown = {(read_words(line.values[0]) or ["paper"])[0] for line in COMMAND_LINES}
    cells = "\n".join(block.text for block in BLOCKS)
    assert command in shown or f"jaxtube.experiments {command}" in cells


@pytest.mark.parametrize("command", COMMANDS)
def test_the_reference_of_commands_has_every_option(command):
    reference = import_extension("commands").write_reference()
    section = reference.partition(f"## `{command}`\n")[2].partition("\n## ")[0]
    options = [
        flag(field.name)
        for field in dataclasses.fields(COMMANDS[command])
        if not re.search("Suppress|Positional", str(field.type))
    ]
    assert [option for option in options if option not in section] == []


def test_the_reference_of_a_scenario_has_every_key():
    reference = import_extension("scenario_keys").write_reference()
    for section, table in Scenario.__annotations__.items():
        rows = reference.partition(f"## `[{section}]`\n")[2].partition("\n## ")[0]
        missing = [key for key in table.__struct_fields__ if f"| `{key}` |" not in rows]
        assert (section, missing) == (section, [])


def test_defaults_that_depend_on_other_keys_are_of_keys_without_one():
    extension = import_extension("scenario_keys")
    for key in extension.FILLED_IN:
        section, name = key.split(".")
        table = Scenario.__annotations__[section]
        assert table.__struct_defaults__[table.__struct_fields__.index(name)] is None


@pytest.mark.parametrize(
    ("docstring", "page"),
    [
        (["Words.", "", "    a = b"], ["Words.", "", "::", "", "    a = b"]),
        (["Args:", "    a: b * c."], ["Args:", r"    a: b \* c."]),
        (["|x| of `a*b`"], [r"\|x\| of `a*b`"]),
        (
            ["Words.", "", "    a*b", "", "More|"],
            ["Words.", "", "::", "", "    a*b", "", r"More\|"],
        ),
    ],
)
def test_docstrings_keep_their_formulas_and_examples(docstring, page):
    extension = import_extension("docstrings")
    assert extension.escape_markup(extension.mark_literal_blocks(docstring)) == page


def test_formulas_are_mathml_with_a_space_between_function_and_argument():
    write_formula = import_extension("mathml").write_formula
    assert "<mi>cos</mi><mspace" in write_formula(r"\cos a")
    assert "<mspace" not in write_formula(r"a b")


@pytest.mark.parametrize("name", jaxtube.__all__)
def test_every_public_name_is_described(name):
    documented = getattr(jaxtube, name).__doc__
    assert documented and not documented.startswith(f"{name}(")


@pytest.mark.parametrize("module", [jaxtube, sets], ids=lambda module: module.__name__)
def test_the_reference_of_python_takes_all_public_names(module):
    page = DOCS / "reference" / {"jaxtube": "api.md", "sets": "sets.md"}[module.__name__]
    text = page.read_text(encoding="utf-8")
    assert re.search(rf"automodule:: {module.__name__}\n   :members:\n", text)


def test_the_map_from_equations_names_what_exists():
    page = (DOCS / "theory.md").read_text(encoding="utf-8")
    maps = page.partition("## From equation to function")[2]
    rows = [line for line in maps.splitlines() if line.startswith("| ") and "`" in line]
    names = [name for row in rows for name in re.findall(r"`((?:jaxtube|sets)\.[\w.]+)`", row)]
    assert len(names) > len(rows) / 2
    for name in names:
        assert callable(find(name)) or isinstance(find(name), property), name


@pytest.mark.parametrize("number", range(1, 42))
def test_the_map_has_every_equation_of_the_paper(number):
    page = (DOCS / "theory.md").read_text(encoding="utf-8")
    maps = page.partition("Equations of the paper:")[2].partition("Beyond the paper")[0]
    ranges = re.findall(r"\((\d+)\)(?:-\((\d+)\))?", maps)
    covered = {n for low, high in ranges for n in range(int(low), int(high or low) + 1)}
    assert number in covered


def find(name: str) -> object:
    """Return what a dotted name means."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:count]))
        except ModuleNotFoundError:
            continue
        for part in parts[count:]:
            found = getattr(found, part)
        return found
    raise AssertionError(f"{name}: is no module")
