"""Unseen scenarios, designed and attacked: each certified, or refused by name with the nearest
scenario that holds; none that is certified is ever seen to fail.

    python tests/attack_unseen.py FOLDER [--first 0] [--count 40] [--laps 1000] [--seconds 5]

writes a record a scenario, FOLDER/07.json, as soon as it has one; what a folder has of as many laps
and seconds is not done again. Without laps nothing is attacked. The last line counts.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import tomllib
from pathlib import Path
from typing import Any

import msgspec

sys.path.insert(0, str(Path(__file__).parent))

from mixed_slips import MixedLaws, count_laps
from unseen import COUNT, draw_scenario

from jaxtube import falsify, montecarlo
from jaxtube.atomic import write_atomically
from jaxtube.experiments import environment
from jaxtube.plant.slip_processes import find_process
from jaxtube.scenario.refusal import ScenarioError
from jaxtube.scenario.tree import Scenario, to_toml
from jaxtube.synthesis.attempt import find_fault
from jaxtube.synthesis.design import design
from jaxtube.synthesis.levers import Lever
from jaxtube.synthesis.nearest import find_nearest, find_nearest_bounded
from jaxtube.synthesis.optimise import UnboundedTubeError, optimise
from jaxtube.synthesis.optimum import Optimum
from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.problem import make_problem

PROCESSES = ("iid", "constant", "walk", "vertex", "adversarial")
"""The slip laws that laps are drawn from."""
FAILURES = (
    "w_outside_W",
    "e_outside_E",
    "u_outside_U",
    "wheels_saturated",
    "qp_infeasible",
    "qp_unsolved",
)
"""Events that a certificate excludes."""
SEED = 11


def main() -> None:
    """Make the records that are missing, and count all of them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument("--laps", type=int, default=1000, help="of each slip law, about")
    parser.add_argument("--seconds", type=float, default=5.0)
    options = parser.parse_args()
    environment.compile_quickly()
    environment.keep_compiled_programs()
    options.folder.mkdir(parents=True, exist_ok=True)
    records = []
    for index in range(options.first, options.first + options.count):
        path = options.folder / f"{index:02}.json"
        record = json.loads(path.read_text()) if path.exists() else judge(index)
        write(path, record)
        if record["verdict"] == "certified" and is_short(record, options.laps, options.seconds):
            record |= attack(record, options.laps, options.seconds)
            write(path, record)
        records.append(record)
        print(index, say_record(record), flush=True)
    print(count_records(records))


def write(path: Path, record: dict[str, Any]) -> None:
    """Write a record, whole or not at all."""
    text = json.dumps(record, indent=1)
    write_atomically(path, lambda file: file.write(text.encode()))


def judge(index: int) -> dict[str, Any]:
    """Return the record of a scenario: its certified design, or what denies one and the nearest
    scenario that holds."""
    started = time.perf_counter()
    scenario = draw_scenario(index)
    record: dict[str, Any] = {"index": index, "scenario": to_toml(scenario)}
    try:
        found = optimise(make_problem(scenario))
        fault = find_fault(found.scenario) if found.holds else found.describe_binding()
        record |= describe_search(found)
        if fault:
            nearest = list_nearest(find_nearest(found))
            record |= {"verdict": "refused", "reason": fault, "nearest": nearest}
        else:
            record |= {"verdict": "certified", "designed": to_toml(found.scenario)}
    except ScenarioError as error:
        record |= {"verdict": "no scenario", "reason": str(error)}
    except UnboundedTubeError as error:
        nearest = list_nearest(find_nearest_bounded(scenario))
        record |= {"verdict": "refused", "reason": str(error), "nearest": nearest}
    return record | {"seconds": round(time.perf_counter() - started, 1)}


def describe_search(found: Optimum) -> dict[str, Any]:
    return {"ratio": found.ratio, "excess": found.excess, "binding": found.binding}


def list_nearest(searched: dict[Lever, Scenario | None]) -> list[dict[str, Any]]:
    """Return the nearest scenarios by quantity; the first of them is searched, designed and
    certified once more, from nothing but its text."""
    listed = []
    for lever, nearest in searched.items():
        if nearest is None:
            continue
        entry: dict[str, Any] = {"quantity": lever.name, "value": lever.say_measured(nearest)}
        if not listed:
            again = optimise(make_problem(read_scenario(to_toml(nearest))))
            entry["holds"] = again.holds and not find_fault(again.scenario)
        listed.append(entry)
    return listed


def is_short(record: dict[str, Any], laps: int, seconds: float) -> bool:
    """Whether a record has fewer laps, or was falsified for less time, than is asked for."""
    return record.get("laps", 0) < laps or record.get("falsified_s", 0.0) < seconds


def attack(record: dict[str, Any], laps: int, seconds: float) -> dict[str, Any]:
    """Return what laps of every slip law and searched worst cases show of a certified design that
    was not attacked as long before."""
    started = time.perf_counter()
    made = design(read_scenario(record["designed"]))
    attacked: dict[str, Any] = {}
    if record.get("laps", 0) < laps:
        attacked |= {"laps": laps, "seen": drive(made, laps)}
        attacked["laps_wall_s"] = round(time.perf_counter() - started, 1)
    if record.get("falsified_s", 0.0) < seconds:
        worst = falsify(made, seconds=seconds, seed=SEED)
        attacked |= {"falsified_s": seconds, "falsified": worst.is_violated}
        usages = {limit: row.worst.usage for limit, row in worst.rows.items()}
        attacked |= {"worst": worst.verdict, "usages": usages}
    return attacked


def drive(made: Design, laps: int) -> dict[str, dict[str, int]]:
    """Return by slip law how many laps were run, and how many saw what must not happen.

    About as many laps of each law as are asked for run side by side, which compiles once; where one
    of them saw something, those of each law run on their own.
    """
    mixture = MixedLaws(tuple(map(find_process, PROCESSES)))
    seen = watch(made, mixture, laps * len(PROCESSES))
    if any(seen.values()):
        return {name: {"laps": laps} | watch(made, name, laps) for name in PROCESSES}
    counts = count_laps(mixture, SEED, laps * len(PROCESSES))
    return {name: {"laps": n} | seen for name, n in zip(PROCESSES, counts, strict=True)}


def watch(made: Design, slip: str | MixedLaws, laps: int) -> dict[str, int]:
    """Return what must not happen, by how many laps saw it."""
    run = montecarlo(made, laps=laps, slip=slip, seed=SEED)
    return {event: run.share(event).laps for event in FAILURES}


def read_scenario(text: str) -> Scenario:
    """Return the scenario of a text."""
    return msgspec.convert(tomllib.loads(text), Scenario)


def say_record(record: dict[str, Any]) -> str:
    """Return a record in a line."""
    verdict = record["verdict"]
    if verdict == "certified":
        failures = count_failures(record)
        laps = record.get("laps", 0)
        return f"certified, ratio {record['ratio']:.3f}, {failures} failures in {laps} laps a law"
    nearest = [entry["value"] for entry in record.get("nearest", []) if entry.get("holds", True)]
    return f"{verdict}: {record['reason']}; nearest: {'; '.join(nearest) or 'none'}"


def count_failures(record: dict[str, Any]) -> int:
    """Return how often something that a certificate excludes was seen in laps."""
    return sum(seen[event] for seen in record.get("seen", {}).values() for event in FAILURES)


def count_records(records: list[dict[str, Any]]) -> str:
    """Return how many of each kind there are."""
    verdicts = [record["verdict"] for record in records]
    refused = [record for record in records if record["verdict"] == "refused"]
    cured = sum(any(entry.get("holds") for entry in record["nearest"]) for record in refused)
    return (
        f"{len(records)} scenarios: {verdicts.count('certified')} certified, {len(refused)} "
        f"refused, {cured} of these with a nearest scenario that holds"
    )


if __name__ == "__main__":
    main()
