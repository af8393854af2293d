"""`export`: the controller of a design as NumPy and C99, certified again, and played once."""

from __future__ import annotations

from jaxtube.experiments.export.page import make_page
from jaxtube.experiments.export.report import describe_in_c, describe_in_numpy, say_verdict
from jaxtube.experiments.options import ExportOptions
from jaxtube.experiments.run import folder as run_folder
from jaxtube.experiments.run.designing import make_design
from jaxtube.experiments.run.exit_codes import ExitCode, exit_code
from jaxtube.exporting.replay import find_compiler, replay_in_c, replay_in_numpy
from jaxtube.exporting.write import Exported, export
from jaxtube.progress import announce
from jaxtube.scenario.tree import Scenario


def run(scenario: Scenario, options: ExportOptions) -> int:
    """Run the command; returns 3 for what is not certified, where a certificate is required, and 1
    where recorded steps come out differently."""
    announce("designing: sets, gains and certificate")
    made = make_design(scenario, options)
    folder = run_folder.create(scenario, options)
    announce("proving the numbers again, and recording laps to play")
    exported = export(made, options.controller_folder, options.label)
    folder.report(say_verdict(exported))
    folder.report(f"{exported}\n")
    replay = replay_in_numpy(exported.folder)
    folder.report(describe_in_numpy(replay))
    compiler = find_compiler()
    in_c = None if compiler is None else replay_in_c(exported.folder, compiler)
    folder.report(describe_in_c(in_c))
    folder.save_metrics(list_metrics(exported) | {"replayed": replay._asdict()})
    folder.save_page(make_page(made, exported, replay, in_c))
    print(f"\nREADME.md in {exported.folder}/ says how to use it")
    if replay.wrong or (in_c is not None and in_c.is_compiled and not in_c.is_same):
        return ExitCode.METRIC_OFF
    return exit_code(made.certificate, options.require_certificate)


def list_metrics(exported: Exported) -> dict[str, object]:
    """Return what was exported in numbers."""
    proofs = {name: proof and proof.describe() for name, proof in exported.proofs.items()}
    return {
        "recorded_steps": exported.recorded,
        "most_operations": exported.operations,
        "exported": proofs,
    }
