"""The command line: reads the options, runs one command, and turns what it raises into an exit code
and one line.

    0  done        1  a checked metric is off, or `doctor` found a fault        2  bad input
    3  an empty tightened set; under --require-certificate also an empty terminal set,
       or a failed certificate
    4  interrupted, or stopped by a full disk; the same command goes on

Nothing heavy is imported before a command runs.
"""

import contextlib
import dataclasses
import errno
import importlib
import importlib.metadata
import inspect
import io
import os
import re
import shutil
import sys
import warnings
from collections.abc import Iterable, Iterator, Sequence

import tyro
from tyro.extras import subcommand_type_from_defaults

from jaxtube.experiments.options import COMMANDS, DEFAULT_COMMAND, PROGRAM, Options
from jaxtube.experiments.run.exit_codes import ExitCode

DESCRIPTION = (
    "Robust tube MPC of a wheeled robot that slips. Without a command: paper. "
    "Any key of the scenario is overridden by controller.horizon=7 or --controller.horizon 7."
)
COMPLETE = "--complete"
"""Word before a line that a shell asks to complete."""
INTERRUPTED_LINE = "interrupted; run the same command again"
PAIR_OPTIONS = ("--select", "--columns", "--units", "--topics")
"""Options whose value looks like an override."""

LEAST_COLUMNS = 40
"""The parser takes gigabytes to lay out its help in a few columns."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code; bad input costs one line on the standard error,
    never a traceback."""
    words = sys.argv[1:] if arguments is None else arguments
    try:
        if words[:1] == [COMPLETE]:
            return print_completions(words[1:])
        options = parse(words)
        return run(options) if options else 0
    except KeyboardInterrupt:
        return _report(INTERRUPTED_LINE, ExitCode.INTERRUPTED)
    except BrokenPipeError:
        # Whoever read the output has enough of it, as `| head` does; the interpreter must not flush
        # into that pipe.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        line = f"{error.strerror}; make room and run the same command again"
        return _report(line, ExitCode.INTERRUPTED)
    except ValueError as error:
        code = _find_exit_code(error)
        if code is None:
            raise
        return _report(str(error), code)


def parse(arguments: Sequence[str]) -> Options | None:
    """Read the words after the program's name; None when they asked for help or for the version,
    which is then on the standard output.

    Raises:
        ScenarioError: one line, for words that cannot be read.
    """
    words, overrides = _split(_check_text(arguments))
    if words == ["--version"]:
        print(f"jaxtube {importlib.metadata.version('jaxtube')}")
        return None
    asks_for_help = words[:1] in (["-h"], ["--help"])
    if not asks_for_help and (not words or words[0].startswith("-")):
        words = [DEFAULT_COMMAND, *words]
    options = _parse_options(words)
    if options is None:
        return None
    broken_rule = options.find_broken_rule()
    if broken_rule:
        raise _refuse(broken_rule)
    return dataclasses.replace(options, overrides=tuple(overrides))


def print_completions(line: Sequence[str]) -> int:
    """Print the words that a line may end with, one a line; returns 0."""
    from jaxtube.experiments.completion.words import complete

    for word in complete(" ".join(line)):
        print(word)
    return 0


def run(options: Options) -> int:
    """Load the scenario, where one is given, and run the command's own module."""
    from jaxtube.scenario.reading import load
    from jaxtube.scenario.refusal import ScenarioError

    scenario = load(options.scenario, options.scenario_overrides) if options.scenario else None
    try:
        with _warnings_in_lines():
            return importlib.import_module(f"{__package__}.{options.module}").run(scenario, options)
    except ScenarioError as error:
        # What only a design can find out is not told where the scenario came from. A name that no
        # scenario has is that of another one.
        line = str(error)
        if line.startswith("scenario:") and not line.startswith("scenario: name ="):
            line = f"{options.scenario}{line.removeprefix('scenario')}"
        raise ScenarioError(line) from None


@contextlib.contextmanager
def _warnings_in_lines() -> Iterator[None]:
    """Let what is told of paths appear as one line each on the standard error."""
    from jaxtube.paths.places import PathWarning

    with warnings.catch_warnings():
        usual = warnings.showwarning

        def show(message, category, *arguments, **options) -> None:
            if issubclass(category, PathWarning):
                print(message, file=sys.stderr)
            else:
                usual(message, category, *arguments, **options)

        warnings.showwarning = show
        yield


def _check_text(arguments: Sequence[str]) -> Sequence[str]:
    """Refuse words that hold bytes of no text: they could not be written to any file."""
    for word in arguments:
        try:
            word.encode()
        except UnicodeEncodeError:
            shown = word.encode(errors="backslashreplace").decode()
            raise _refuse(f"{shown}: is no text in UTF-8; give a name without such bytes") from None
    return arguments


def _split(arguments: Iterable[str]) -> tuple[list[str], list[str]]:
    """Take the overrides `a.b=1`, `--a.b=1` and `--a.b 1` out of the words, all as `a.b=1`."""
    words = []
    overrides = []
    pending = ""
    for word in arguments:
        if words and words[-1] in PAIR_OPTIONS:
            words.append(word)
        elif pending:
            overrides.append(f"{pending}={word}")
            pending = ""
        elif re.match(r"(--)?\w+(\.\w+)+=|\w+=", word):
            overrides.append(word.removeprefix("--"))
        elif re.fullmatch(r"--\w+(\.\w+)+", word):
            pending = word.removeprefix("--")
        else:
            words.append(word)
    if pending:
        raise _refuse(f"{pending}: has no value; write {pending}=VALUE")
    return words, overrides


def _parse_options(words: list[str]) -> Options | None:
    """Parse a command and its options; None after help."""
    if shutil.get_terminal_size().columns < LEAST_COLUMNS:
        os.environ["COLUMNS"] = str(LEAST_COLUMNS)
    commands = subcommand_type_from_defaults(
        {name: kind() for name, kind in COMMANDS.items()},
        {name: inspect.getdoc(kind) or "" for name, kind in COMMANDS.items()},
    )
    errors = io.StringIO()
    try:
        with contextlib.redirect_stderr(errors):
            return tyro.cli(
                commands,
                default=COMMANDS[DEFAULT_COMMAND](),
                args=words,
                prog=PROGRAM,
                description=DESCRIPTION,
                config=(tyro.conf.FlagCreatePairsOff,),
            )
    except SystemExit as stop:
        if not stop.code:
            return None
        from jaxtube.experiments.misread import explain

        raise _refuse(explain(words, errors.getvalue())) from None


def _refuse(text: str) -> ValueError:
    from jaxtube.scenario.refusal import ScenarioError

    return ScenarioError(f"command line: {text}")


def _find_exit_code(error: ValueError) -> int | None:
    """Return the exit code of an error that users can mend, None for a fault of the program."""
    from jaxtube.scenario.refusal import ScenarioError

    if isinstance(error, ScenarioError):
        return ExitCode.BAD_INPUT
    from jaxtube.experiments.run.store import StoreError
    from jaxtube.synthesis.design import EmptySetError

    if isinstance(error, StoreError):
        return ExitCode.INTERRUPTED
    return ExitCode.NO_GUARANTEE if isinstance(error, EmptySetError) else None


def _report(line: str, code: int) -> int:
    """Print one line on the standard error, which never raises for a character, and return the
    code."""
    text = " ".join(line.split())
    encoding = sys.stderr.encoding or "utf-8"
    print(text.encode(encoding, "backslashreplace").decode(encoding), file=sys.stderr)
    return code
