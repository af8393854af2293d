"""Progress of a descent as a bar on the standard error."""

from __future__ import annotations

from collections.abc import Callable
from typing import Self

import numpy as np

from jaxtube.progress import ProgressBar
from jaxtube.tuning.judgement import HeldOutJudgement


class DescentBar:
    """Bar that counts the gradients of a descent and shows its last iterate."""

    def __init__(
        self, bar: ProgressBar, save: Callable[[HeldOutJudgement], None] | None = None
    ) -> None:
        """Take a bar that has begun.

        Args:
            bar: of as many units as gradients may be taken.
            save: is told of every certified iterate that is the best so far.
        """
        self._bar = bar
        self._save = save
        self._best = np.inf

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        if error[0] is None:
            self._bar.total = self._bar.n
        self._bar.close()

    def on_evaluation(self) -> None:
        """Count an evaluation."""
        self._bar.update()

    def on_iterate(self, judgement: HeldOutJudgement, is_best: bool) -> None:
        """Show an iterate, and save it where it is the best certified one so far."""
        if is_best:
            self._best = judgement.held_out
            if self._save:
                self._save(judgement)
        self._bar.set_postfix_str(describe_iterate(judgement, self._best), refresh=False)


def describe_iterate(judgement: HeldOutJudgement, best: float) -> str:
    """Return an iterate in a few words, and the least objective of a certified one."""
    if not judgement.has_laps:
        return f"no closed loop ({judgement.failing[0]})"
    state = "certified"
    if not judgement.certified:
        state = f"not certified ({', '.join(judgement.failing)})"
    least = f", best certified {best:.4g}" if np.isfinite(best) else ""
    return (
        f"held out {judgement.held_out:.4g}{least}; lateral {1e3 * judgement.lateral:.2f} mm, "
        f"effort {judgement.overall_effort:.4f} m/s; {state}"
    )
