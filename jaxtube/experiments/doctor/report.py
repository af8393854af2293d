"""The report of `doctor`: the verdict, then a line for everything that was checked."""

from __future__ import annotations

from collections.abc import Sequence

from jaxtube.experiments.doctor.finding import Finding
from jaxtube.experiments.run.table import wrap

LEGEND = (
    "ok: works; missing: not found; wrong: found, and does not do what it has to; (optional): "
    "jaxtube works without it; an extra: packages for one purpose."
)
STATE_WIDTH = 9


def report(findings: Sequence[Finding], seconds: float) -> str:
    """Return the report as text."""
    lines = [say_verdict(findings), "", *wrap(LEGEND), ""]
    width = max(len(_name(each)) for each in findings) + 2
    for finding in findings:
        lines += _lines(finding, width)
    lines += [
        "",
        f"checked in {seconds:.1f} s; a first run also compiles, which takes as long again",
    ]
    return "\n".join(lines)


def say_verdict(findings: Sequence[Finding]) -> str:
    """Return one line: whether jaxtube works here, and where not, what is at fault."""
    faults = [finding.name for finding in findings if finding.is_fault]
    if not faults:
        return "ready: everything that jaxtube needs works here"
    shown = ", ".join(faults[:4])
    more = f" and {len(faults) - 4} more" if len(faults) > 4 else ""
    return f"NOT ready, at fault: {shown}{more}"


def _name(finding: Finding) -> str:
    return finding.name if finding.is_needed else f"{finding.name} (optional)"


def _lines(finding: Finding, width: int) -> list[str]:
    indent = " " * (STATE_WIDTH + width)
    lines = wrap(f"{finding.state:<{STATE_WIDTH}}{_name(finding):<{width}}{finding.words}", indent)
    if finding.cure:
        lines += wrap(f"{indent}cure: {finding.cure}", indent)
    return lines
