"""The page of `export`: what was proved of the numbers as written, and how recorded steps came
out."""

from __future__ import annotations

from collections.abc import Iterator

from jaxtube.experiments.export.report import describe_in_c, describe_in_numpy, say_verdict
from jaxtube.experiments.run.design_page import certificate_section
from jaxtube.exporting.proof import Proof, list_margins
from jaxtube.exporting.replay import Replay, ReplayInC
from jaxtube.exporting.rows import KINDS
from jaxtube.exporting.write import Exported
from jaxtube.reporting.page import Heading, Listing, Page, Section, Table
from jaxtube.synthesis.parts import Design

UNPROVED = (
    "That a plan is found in a period is not proved: where none is, the controller says so.",
    "Compiled code is not proved: the steps that were played are all that is known of it.",
)
NOTE = (
    "Missed: by how much a plan that the controller accepts may miss a row of the design, and the "
    "other way round, together, in the units of that row. Margin: what the certificate leaves for "
    "it, once what is missed is taken off."
)


def make_page(design: Design, exported: Exported, replay: Replay, in_c: ReplayInC | None) -> Page:
    """Return the page of an export.

    Args:
        design: of the controller.
        exported: what was written.
        replay: of recorded steps in NumPy.
        in_c: the same in C, None where there is no compiler.
    """
    is_certified = any(proof and proof.certifies for proof in exported.proofs.values())
    headings = [
        Heading("numbers"),
        Heading("sets"),
        Heading("rooms"),
        *(Heading(f"missed: {kind}", True) for kind in KINDS),
    ]
    rows = [list(_list_cells(name, proof)) for name, proof in exported.proofs.items()]
    proved = list_margins(exported.proofs)
    played = [" ".join(describe_in_numpy(replay).split())]
    played += [line.strip() for line in describe_in_c(in_c).splitlines()]
    return Page(
        say_verdict(exported),
        "good" if is_certified and not replay.wrong else "bad",
        [
            f"The controller is in `{exported.folder}/`; README.md there says how to use it "
            "and when its guarantee holds."
        ],
        [
            Section("Numbers as written", [Listing(proved), Table("", headings, rows, NOTE)]),
            Section("Recorded steps", [Listing(played)]),
            certificate_section(design.certificate),
        ],
        [*UNPROVED, *design.certificate.assumptions],
    )


def _list_cells(name: str, proof: Proof | None) -> Iterator[str]:
    """Yield the row of a precision."""
    yield name
    if proof is None:
        yield from ("not offered", *["-"] * (len(KINDS) + 1))
        return
    yield proof.design.certificate.verdict
    yield str(proof.describe()["rooms"])
    for kind in KINDS:
        yield f"{proof.missed[kind]:.2g}"
