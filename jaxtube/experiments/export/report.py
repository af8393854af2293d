"""What `export` prints."""

from __future__ import annotations

from jaxtube.exporting.replay import Replay, ReplayInC
from jaxtube.exporting.write import Exported


def say_verdict(exported: Exported) -> str:
    """Return in one line what came out."""
    certified = [name for name, proof in exported.proofs.items() if proof and proof.certifies]
    if certified:
        return f"exported and certified again as written, in {' and '.join(certified)}"
    return "exported; NOT CERTIFIED for the robot: see certificate.json"


def describe_in_numpy(replay: Replay) -> str:
    """Return how recorded steps came out in NumPy."""
    outcome = f"{replay.wrong:,} of them come out differently" if replay.wrong else "as recorded"
    return (
        f"controller.py plays {replay.steps:,} recorded steps {outcome}: wheel speeds within "
        f"{replay.worst:.2g} m/s,\n{replay.median_us:.0f} us a step (median), "
        f"{replay.most_us:.0f} us for 99.9 % of them"
    )


def describe_in_c(replay: ReplayInC | None) -> str:
    """Return what main.c printed, or that it was not compiled."""
    if replay is None:
        return "c/ was not compiled: there is no C compiler here (cc, gcc, clang)"
    lines = replay.printed.strip().splitlines()[:3]
    if not replay.is_compiled:
        return "\n".join(["c/ could not be compiled here:", *(f"  {line}" for line in lines)])
    return "\n".join(["main.c, compiled here, plays them:", *(f"  {line}" for line in lines)])
