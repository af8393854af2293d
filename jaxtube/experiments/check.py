"""`check`: run scenarios again and compare their metrics with the expected ones.

The file expected.toml beside a scenario holds the claims,

    [[metric]]
    path = "tube_half_widths.paper.5.1"     keys and list indices into metrics.json
    value = 0.038934
    tolerance = 5e-7                        |metric - value| <= tolerance
    provenance = "independent computation"
    command = "design"                      or "paper", "identify": the run that writes the metric

and, for what `identify` must find in a log beside it,

    [identify]
    log = "drive.csv"
    box = "alike"
    least_wheel_mps = 0.1
"""

import importlib
import math
import tomllib
from collections import Counter
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from jaxtube.experiments.options import COMMANDS, CheckOptions, title
from jaxtube.experiments.run.exit_codes import ExitCode
from jaxtube.experiments.run.json_file import read_table
from jaxtube.progress import announce
from jaxtube.scenario.reading import experiments_folder, find, load, names
from jaxtube.scenario.refusal import ScenarioError, literal
from jaxtube.scenario.tree import Scenario

MISSING = object()


class Metric(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One claim: the number, text or truth value that a run has to give."""

    path: str
    value: bool | int | float | str
    provenance: str
    tolerance: Annotated[float, msgspec.Meta(ge=0)] = 0.0
    command: Literal["design", "paper", "identify"] = "design"


class Log(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The log that metrics of `identify` come from, and the choices made before."""

    log: str
    box: Literal["each", "alike", "scaled"] = "each"
    least_wheel_mps: Annotated[float, msgspec.Meta(gt=0)] | None = None


class Claims(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The file expected.toml."""

    metric: tuple[Metric, ...] = ()
    identify: Log | None = None


def run(scenario: Scenario | None, options: CheckOptions) -> int:
    """Print one line a metric; returns 0 when all hold, else 1.

    Raises:
        ScenarioError: for a scenario without expected metrics that was asked for by name.
    """
    checked = _checked_names(scenario, options)
    if not checked:
        raise ScenarioError(
            f"{experiments_folder()}: no scenario has an expected.toml; name a scenario that has "
            "one"
        )
    verdicts: Counter[str] = Counter()
    for name in checked:
        verdicts.update(_check(name, options))
    print(f"{verdicts['ok']} ok, {verdicts['off']} off, {verdicts['skipped']} skipped")
    return ExitCode.METRIC_OFF if verdicts["off"] else ExitCode.DONE


def resolve(metrics: Any, path: str) -> Any:
    """Follow a dotted path of keys and list indices; MISSING where it leads nowhere."""
    node = metrics
    for name in path.split("."):
        try:
            node = node[int(name)] if isinstance(node, list) else node[name]
        except (LookupError, TypeError, ValueError):
            return MISSING
    return node


def holds(actual: Any, metric: Metric) -> bool:
    """Say whether a metric is the expected one: numbers within the tolerance, anything else equal
    and of one type."""
    numbers = (int, float)  # bool, a subclass of int, is none
    if type(actual) in numbers and type(metric.value) in numbers:
        return abs(actual - metric.value) <= metric.tolerance
    return type(actual) is type(metric.value) and actual == metric.value


def _checked_names(scenario: Scenario | None, options: CheckOptions) -> tuple[str, ...]:
    """Return the scenarios that were named, or all that have claims."""
    if options.names:
        return options.names
    return (options.scenario,) if scenario else tuple(filter(_has_claims, names()))


def _has_claims(name: str) -> bool:
    return _claims_file(name).exists()


def _claims_file(name: str) -> Path:
    return find(name).with_name("expected.toml")


def read_claims(name: str) -> Claims:
    """Read the expected metrics beside a scenario.

    Raises:
        ScenarioError: one line, for a file that cannot be read or is damaged.
    """
    path = _claims_file(name)
    try:
        tree = tomllib.loads(path.read_text(encoding="utf-8"))
        claims = msgspec.convert(tree, Claims)
    except OSError as error:
        raise ScenarioError(
            f"{path}: cannot be read ({error.strerror}); write the expected metrics there"
        ) from None
    except (ValueError, RecursionError) as error:
        told = " ".join(str(error).split())
        raise ScenarioError(
            f"{path}: {told}; give path, value, tolerance and provenance of each [[metric]]"
        ) from None
    if claims.identify is not None and not _is_name(claims.identify.log):
        shown = literal(claims.identify.log)
        raise ScenarioError(
            f"{path}: identify.log = {shown}: is no name of a file beside it; name the log there"
        )
    for metric in claims.metric:
        for number in (metric.value, metric.tolerance):
            if isinstance(number, float) and not math.isfinite(number):
                where = " ".join(metric.path.split())
                raise ScenarioError(
                    f"{path}: {where}: {number} is not finite; give a finite number"
                )
        if metric.command == "identify" and claims.identify is None:
            raise ScenarioError(
                f"{path}: {metric.path} is of `identify`, and no log is named; add [identify] with "
                'log = "FILE"'
            )
    return claims


def _is_name(text: str) -> bool:
    """Tell whether a text is the name of a file without its folder."""
    return text not in ("", "..") and Path(text).name == text


def _check(name: str, options: CheckOptions) -> list[str]:
    claims = read_claims(name)
    commands = {claim.command for claim in claims.metric}
    if options.quick:
        commands.discard("paper")
    results = {command: _run_again(command, name, claims, options) for command in sorted(commands)}
    return [_judge(name, claim, results) for claim in claims.metric]


def _run_again(command: str, name: str, claims: Claims, options: CheckOptions) -> Any:
    """Run a command on a scenario, or on its log, and return its metrics; an empty table when the
    run did not end well."""
    out = Path(options.out or "runs") / f"check-{title(name)}" / command
    kind = COMMANDS[command]
    scenario = None
    if command == "identify":
        assert claims.identify is not None
        choices = msgspec.structs.asdict(claims.identify)
        choices["log"] = str(find(name).with_name(claims.identify.log))
    else:
        choices = {"scenario": name, "overrides": options.overrides}
        scenario = load(name, options.overrides)
    settings = kind(out=str(out), seed=options.seed, **choices)
    announce(f"{name}: running `{command}`")
    module = importlib.import_module(f"{__package__}.{kind.module}")
    code = module.run(scenario, settings)
    if code:
        print(f"{name}: {command} ended with exit code {code}")
        return {}
    return read_table(out / "metrics.json")


def _judge(name: str, claim: Metric, results: dict[str, Any]) -> str:
    verdict = "skipped"
    shown = "not run"
    if claim.command in results:
        actual = resolve(results[claim.command], claim.path)
        verdict = "ok" if holds(actual, claim) else "off"
        shown = "missing" if actual is MISSING else str(actual)
    bound = f" +- {claim.tolerance:g}" if claim.tolerance else ""
    print(
        f"{verdict:8}{name}  {claim.path}  {shown}  expected {claim.value}{bound}  "
        f"({claim.provenance})"
    )
    return verdict
