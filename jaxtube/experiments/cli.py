"""The command line: reads the options, runs one command, and turns what it raises into an exit code
and one line.

    0  done        1  a checked metric is off        2  bad input
    3  an empty tightened set; an empty terminal set or a failed certificate under --require-certificate
    4  interrupted, or stopped by a full disk; the same command goes on

Nothing heavy is imported before a command runs.
"""

import contextlib
import dataclasses
import errno
import importlib
import inspect
import io
import itertools
import os
import re
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

import tyro
from tyro.extras import subcommand_type_from_defaults

from jaxtube.experiments.options import COMMANDS, PROGRAM, Options

DESCRIPTION = (
    "Robust tube MPC of a wheeled robot that slips. Without a command: paper. "
    "Any key of the scenario is overridden by controller.horizon=7 or --controller.horizon 7."
)
DEFAULT_COMMAND = "paper"
BAD_INPUT, EMPTY_SET, INTERRUPTED = 2, 3, 4
SEED_LIMIT = 2**63
REALISATIONS_LIMIT = 2**53


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code; bad input costs one line on the standard error,
    never a traceback."""
    try:
        options = parse(sys.argv[1:] if arguments is None else arguments)
        return run(options) if options else 0
    except KeyboardInterrupt:
        return _report("interrupted; run the same command again", INTERRUPTED)
    except BrokenPipeError:
        # Whoever read the output has enough of it, as `| head` does; the interpreter must not flush
        # into that pipe.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        return _report(f"{error.strerror}; make room and run the same command again", INTERRUPTED)
    except ValueError as error:
        code = _exit_code(error)
        if code is None:
            raise
        return _report(str(error), code)


def parse(arguments: Sequence[str]) -> Options | None:
    """Read the words after the program's name; None when they asked for help, which is then on the
    standard output.

    Raises: ScenarioError, one line.
    """
    words, overrides = _split(arguments)
    if not words or (words[0].startswith("-") and words[0] not in ("-h", "--help")):
        words = [DEFAULT_COMMAND, *words]
    errors = io.StringIO()
    try:
        with contextlib.redirect_stderr(errors):
            options = tyro.cli(
                subcommand_type_from_defaults(
                    {name: kind() for name, kind in COMMANDS.items()},
                    {name: inspect.getdoc(kind) or "" for name, kind in COMMANDS.items()},
                ),
                default=COMMANDS[DEFAULT_COMMAND](),
                args=words,
                prog=PROGRAM,
                description=DESCRIPTION,
                config=(tyro.conf.FlagCreatePairsOff,),
            )
    except SystemExit as stop:
        if not stop.code:
            return None
        raise _refusal(f"{_sentence(errors.getvalue())}; see {PROGRAM} --help") from None
    _check(options)
    return dataclasses.replace(options, overrides=tuple(overrides))


def run(options: Options) -> int:
    """Load the scenario, where one is given, and run the command's own module."""
    from jaxtube.scenario import ScenarioError, load

    scenario = load(options.scenario, options.overrides) if options.scenario else None
    try:
        return importlib.import_module(f"{__package__}.{options.module}").run(scenario, options)
    except ScenarioError as error:
        # What only a design can find out is not told where the scenario came from.
        raise ScenarioError(re.sub("^scenario:", f"{options.scenario}:", str(error))) from None


def _split(arguments: Iterable[str]) -> tuple[list[str], list[str]]:
    """Take the overrides `a.b=1`, `--a.b=1` and `--a.b 1` out of the words, all as `a.b=1`."""
    words, overrides, pending = [], [], ""
    for word in arguments:
        if pending:
            overrides.append(f"{pending}={word}")
            pending = ""
        elif re.match(r"(--)?\w+(\.\w+)+=|\w+=", word):
            overrides.append(word.removeprefix("--"))
        elif re.fullmatch(r"--\w+(\.\w+)+", word):
            pending = word.removeprefix("--")
        else:
            words.append(word)
    if pending:
        raise _refusal(f"{pending}: has no value; write {pending}=VALUE")
    return words, overrides


def _check(options: Options) -> None:
    if not 0 <= options.seed < SEED_LIMIT:
        raise _refusal(
            f"--seed = {options.seed}: is out of range; give a whole number from 0 to 2^63 - 1"
        )
    realisations = getattr(options, "realisations", 1)
    if not (realisations >= 1 and realisations == int(min(realisations, REALISATIONS_LIMIT))):
        raise _refusal(
            f"--realisations = {realisations}: is no whole number from 1 to 2^53; simulate at least one run"
        )
    for name, least in (
        ("chunk", 1),
        ("devices", 0),
        ("points", 2),
        ("evaluations", 1),
        ("laps", 1),
        ("held_out", 1),
        ("patience", 1),
    ):
        if (count := getattr(options, name, least)) < least:
            raise _refusal(
                f"--{name.replace('_', '-')} = {count}: is out of range; give a whole number from {least}"
            )
    if not 0 < (rate := getattr(options, "learning_rate", 1.0)) < float("inf"):
        raise _refusal(
            f"--learning-rate = {rate}: is out of range; give a positive number, such as 0.1"
        )
    if Path(options.out).is_file():
        raise _refusal(f"--out = {options.out}: is a file; name a folder")


def _sentence(box: str) -> str:
    """Reduce the box that the parser draws around its message to what is wrong and the nearest
    right word."""
    lines = [re.sub(r"\x1b\[[0-9;]*m|[|│╭╮╰╯]", "", line).strip() for line in box.splitlines()[1:]]
    groups = itertools.groupby(lines, lambda line: set(line) <= set("-+─"))
    first, *paragraphs = [list(group) for ruled, group in groups if not ruled] or [
        ["not understood"]
    ]
    sentences = [" ".join(first).rstrip(".")]
    for heading, *others in paragraphs:
        if heading.startswith("Available"):
            sentences.append(" ".join([heading, *others]))
        if heading.startswith("Perhaps you meant") and others:
            sentences.append(f"did you mean {others[0].split()[0]}?")
    return "; ".join(sentences)


def _refusal(text: str) -> ValueError:
    from jaxtube.scenario import ScenarioError

    return ScenarioError(f"command line: {text}")


def _exit_code(error: ValueError) -> int | None:
    from jaxtube.scenario import ScenarioError

    if isinstance(error, ScenarioError):
        return BAD_INPUT
    from jaxtube.experiments.run.records import RecordsError
    from jaxtube.synthesis.design import EmptySetError

    if isinstance(error, RecordsError):
        return INTERRUPTED
    return EMPTY_SET if isinstance(error, EmptySetError) else None


def _report(line: str, code: int) -> int:
    print(" ".join(line.split()), file=sys.stderr)
    return code
