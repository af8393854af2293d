"""The line of a report that says where the proof of a certificate was written, and what checks
it."""

from __future__ import annotations

import shlex
from pathlib import Path

from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.proof_file import list_unchecked, write_certificate
from jaxtube.synthesis.proof_search import PROGRAMS


def write_proof(design: Design, folder: Path, name: str) -> str:
    """Write the proof of a certified design into the folder of its run; return what is said of
    it."""
    unchecked = list_unchecked(design)
    path = write_certificate(design, folder, name)
    if unchecked:
        return (
            f"proof: {path.name} only says what its checker knows nothing of: "
            f"{', '.join(unchecked)}"
        )
    words = shlex.join(["python3", str(folder / PROGRAMS[0]), str(path)])
    about = "" if design.certificate.holds_for_robot else " for the linear model alone"
    return f"proof{about} in {path}, for Python's standard library to check: {words}"
