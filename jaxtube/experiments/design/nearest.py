"""What `design` says where it fails: whether other caps and gains hold, and else the nearest values
of the keys that decide for which a certified design was found."""

from __future__ import annotations

import shlex

from jaxtube.experiments.options import PROGRAM, FitOptions, Options
from jaxtube.progress import progress
from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.advice import say_what_widens
from jaxtube.synthesis.levers import FITTED
from jaxtube.synthesis.nearest import (
    ON_PATH,
    SEARCHED,
    WHEEL_SPEEDS,
    find_nearest,
    find_nearest_bounded,
)
from jaxtube.synthesis.optimise import UnboundedTubeError, can_optimise, optimise
from jaxtube.synthesis.optimum import Optimum
from jaxtube.synthesis.problem import make_problem
from jaxtube.synthesis.starts import caps_and_gains, without_caps


def say_nearest(scenario: Scenario, options: Options) -> list[str]:
    """Return sentences for a scenario whose own design fails; none where caps and gains of its kind
    cannot be searched. Takes seconds."""
    if not can_optimise(scenario):
        return []
    try:
        found = optimise(make_problem(without_caps(scenario)), near=caps_and_gains(scenario))
    except UnboundedTubeError as error:
        return [str(error), *say_nearest_bounded(scenario)]
    except ValueError:
        return []
    if found.holds:
        return [
            f"other caps and gains hold as far as estimated, and the tube fills {found.ratio:.1%} "
            f"of them: {_command('design --optimise', options)} designs them"
        ]
    return say_nearest_to(found, options)


def say_nearest_to(found: Optimum, options: Options) -> list[str]:
    """Return sentences for the best caps and gains of a scenario that no design was found for; of
    bands what binds alone, as no key scales their ends."""
    if found.scenario.operating.bands:
        return [f"at best {found.describe_binding()}"]
    with progress(SEARCHED, "searching the nearest that holds", "keys", starting="starting") as bar:
        nearest = find_nearest(found, bar.update)
    widened = say_what_widens(make_problem(found.scenario))
    lines = [f"at best {found.describe_binding()}", *([widened] if widened else [])]
    held = [lever.say(scenario) for lever, scenario in nearest.items() if scenario is not None]
    if held:
        lines.append(
            f"nearest found, each certified{_say_start(found.scenario)}: {'; or '.join(held)}"
        )
    missing = [lever.name for lever, scenario in nearest.items() if scenario is None]
    if missing:
        lines.append(f"nothing certified was found by another {' or '.join(missing)} alone")
    asked = options.quantity if isinstance(options, FitOptions) else ""
    fitted = [lever.name for lever in nearest if lever.name in FITTED and lever.name != asked]
    if fitted:
        lines.append(f"the border itself: {_command(f'fit {fitted[0]}', options)}")
    return lines


def say_nearest_bounded(scenario: Scenario) -> list[str]:
    """Return sentences for a scenario of which no gains bound a tube."""
    with progress(
        len(WHEEL_SPEEDS), "searching the nearest that holds", "keys", starting="starting"
    ) as bar:
        nearest = find_nearest_bounded(scenario, bar.update)
    return [
        f"nearest found, certified{_say_start(scenario)}: {lever.say(held)}"
        if held is not None
        else f"nothing certified was found by another {lever.name} alone"
        for lever, held in nearest.items()
    ]


def _say_start(scenario: Scenario) -> str:
    """Return for which starts what is nearest was certified, nothing where it is the scenario's."""
    return "" if scenario.initial == ON_PATH else " for starts on the path"


def _command(command: str, options: Options) -> str:
    """Return a command on the scenario of these options."""
    words = shlex.join(["--scenario", options.scenario, *options.overrides])
    return f"`{PROGRAM} {command} {words}`"
