"""`export`: the controller of a design leaves the program, with the proof of its numbers.

    controller.py, controller.npz                  in NumPy
    c/controller.h, controller.c, constants.h, constants.c, main.c, steps.csv, Makefile
    certificate.json                               of the design, and of the numbers as written
    README.md, SHA256SUMS

While the files are written SHA256SUMS is missing, and what lies there is refused.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxtube.atomic import write_atomically
from jaxtube.exporting.c_source import count_operations, render_header, render_source
from jaxtube.exporting.constants import Constants
from jaxtube.exporting.proof import Proof, list_margins, prove_doubles, prove_floats
from jaxtube.exporting.readme import render_readme
from jaxtube.exporting.recording import Recording, draw_starts, record_laps
from jaxtube.exporting.templating import read_template
from jaxtube.precision import in_64_bits
from jaxtube.scenario.refusal import ScenarioError, refusal
from jaxtube.synthesis.parts import Design, require_design
from jaxtube.synthesis.stored_certificate import list_certificate_facts

LAPS = 4
"""Laps of recorded steps, from the scenario's start and again from the edge of the feasible set."""
SUMS = "SHA256SUMS"
SHOWN_NAMES = 3
"""Files named in a message."""
MADE = ("replay_steps", "replay_floats")
"""What the Makefile makes."""
STATIC = {
    "controller.py": "controller.py",
    "c/controller.h": "controller.h",
    "c/controller.c": "controller.c",
    "c/main.c": "main.c",
    "c/Makefile": "Makefile",
}
"""Templates by the files that they are, unchanged."""
RENDERED = (
    "certificate.json",
    "controller.npz",
    "c/constants.h",
    "c/constants.c",
    "c/steps.csv",
    "README.md",
)
FILES = (*STATIC, *RENDERED, SUMS)
"""All files of an export."""


class Exported(NamedTuple):
    """An exported controller.

    Attributes:
        folder: where it lies.
        constants: its numbers.
        proofs: of its numbers, by precision; None where float32 is not offered.
        recorded: steps in steps.csv.
        operations: of floating point in a plan, at most.
    """

    folder: Path
    constants: Constants
    proofs: dict[str, Proof | None]
    recorded: int
    operations: int

    def __repr__(self) -> str:
        verdict = self.proofs["float64"].design.certificate.verdict  # type: ignore[union-attr]
        return "\n".join(
            [
                f"{verdict}: controller in {self.folder}/",
                *list_margins(self.proofs),
                f"{self.recorded:,} recorded steps; a plan takes {self.operations:,} operations of "
                "floating point at most",
            ]
        )


@in_64_bits
def export(design: Design, folder: str | Path, title: str = "a design") -> Exported:
    """Write the tube-MPC of a design as NumPy and C99, certified again as it is written.

    Args:
        design: a design, certified or not; its verdict stands in every file.
        folder: a new or an empty one, or one that an export has written, which is replaced.
        title: of the design, for people.

    Raises:
        ScenarioError: one line, for a folder with anything else, or one that cannot be written; for
            a design whose controller learns slips; and where the numbers, rounded to float64, do
            not keep the guarantee of the design.
    """
    require_design(design)
    _refuse_learning(design)
    path = Path(folder)
    refuse_foreign(path)
    proof = _settle(prove_doubles(design))
    if not proof.holds:
        raise ScenarioError(
            "scenario: controller: rows rounded to float64 do not keep the guarantee "
            f"(least margin {min(proof.margins.values()):.3g}); bring the sizes of caps and "
            "weights closer together"
        )
    floats = prove_floats(design)
    if floats is not None:
        floats = _settle(floats) if floats.certifies == proof.certifies else None
    proofs = {"float64": proof, "float32": floats}
    recording = record_laps(design, draw_starts(design, LAPS))
    _write(path, _render(design, proofs, recording, title))
    steps = recording.status.size
    return Exported(path, proof.constants, proofs, steps, count_operations(proof.constants))


def _refuse_learning(design: Design) -> None:
    """Refuse a design whose controller learns slips: what is exported has no observer of them."""
    slip = design.problem.scenario.slip
    if slip.is_learnt:
        raise ScenarioError(
            f"scenario: slip.change_per_s = {slip.change_per_s:g}: an exported controller does not "
            "learn slips; run it by jt.Stepper, or leave it out"
        )


def _settle(proof: Proof) -> Proof:
    """Return a proof whose constants claim no more than it proves."""
    constants = dataclasses.replace(proof.constants, is_certified=proof.certifies)
    return dataclasses.replace(proof, constants=constants)


def _render(
    design: Design,
    proofs: Mapping[str, Proof | None],
    recording: Recording,
    title: str,
) -> dict[str, bytes]:
    """Return the contents of all files by their names."""
    proof = proofs["float64"]
    assert proof is not None
    constants = proof.constants
    floats = proofs["float32"]
    verdict = design.certificate.verdict
    certificate = _describe_certificate(design, proofs)
    digest = hashlib.sha256(certificate).hexdigest()
    contents = {name: read_template(template).encode() for name, template in STATIC.items()}
    of_floats = None if floats is None else floats.constants
    contents |= {
        "certificate.json": certificate,
        "controller.npz": _pack(constants.arrays() | {"certificate_sha256": np.array(digest)}),
        "c/constants.h": render_header(constants, title, verdict, digest).encode(),
        "c/constants.c": render_source(constants, of_floats, title, digest).encode(),
        "c/steps.csv": write_steps(constants, recording).encode(),
        "README.md": render_readme(design, proofs, recording, title).encode(),
    }
    sums = [f"{hashlib.sha256(contents[name]).hexdigest()}  {name}\n" for name in sorted(contents)]
    return contents | {SUMS: "".join(sums).encode()}


def _describe_certificate(design: Design, proofs: Mapping[str, Proof | None]) -> bytes:
    """Return the certificate of a design and of what is exported of it, as JSON."""
    content = list_certificate_facts(design.certificate)
    content["exported"] = {name: proof and proof.describe() for name, proof in proofs.items()}
    return f"{json.dumps(content, indent=2, sort_keys=True)}\n".encode()


def _pack(arrays: Mapping[str, np.ndarray]) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()


def write_steps(constants: Constants, recording: Recording) -> str:
    """Return recorded steps as lines that main.c reads; an empty line begins a lap."""
    lines = []
    steps, laps = recording.status.shape
    for lap in range(laps):
        lines.append("")
        for step in range(steps):
            now = step * constants.dt
            numbers = [*recording.poses[step, lap], now, now]
            wheels = recording.wheels[step, lap]
            slips = recording.slips[step, lap]
            words = ["1", *map(_spell, numbers), "1", *map(_spell, slips), *map(_spell, wheels)]
            lines.append(",".join([*words, str(recording.status[step, lap])]))
    return "\n".join(lines).lstrip("\n") + "\n"


def _spell(number: float) -> str:
    """Return the shortest decimals that are read back to the bit."""
    return repr(float(number))


def refuse_foreign(path: Path) -> None:
    """Raise ScenarioError for a folder that holds anything but an exported controller."""
    cure = "name a new or an empty folder"
    if path.is_file():
        raise refusal("export", "folder", str(path), "is a file", cure)
    # While SHA256SUMS is missing the files are those of an export that was broken off.
    present = [entry.relative_to(path).as_posix() for entry in path.rglob("*")]
    foreign = sorted(name for name in present if not _is_own(name))
    if foreign:
        problem = f"holds files that no export has written ({', '.join(foreign[:SHOWN_NAMES])})"
        raise refusal("export", "folder", str(path), problem, cure)


def _is_own(name: str) -> bool:
    """Tell whether a file is one of an export, or one that a killed export was writing, or what was
    made of such files."""
    folder, _, file = name.rpartition("/")
    if name in ("c", "__pycache__") or folder == "__pycache__" or file in MADE:
        return True
    return any(
        name == own or (folder == own.rpartition("/")[0] and file.startswith(f".{Path(own).name}."))
        for own in FILES
    )


def _write(path: Path, contents: Mapping[str, bytes]) -> None:
    """Write all files, the sums last: without them what lies there is refused."""
    try:
        (path / "c").mkdir(parents=True, exist_ok=True)
        (path / SUMS).unlink(missing_ok=True)
        for name in sorted(contents, key=lambda name: name == SUMS):
            write_atomically(path / name, lambda file, name=name: file.write(contents[name]))
    except OSError as error:
        problem = f"cannot be written ({error.strerror})"
        cure = "name a folder that you may write to"
        raise refusal("export", "folder", str(path), problem, cure) from None
