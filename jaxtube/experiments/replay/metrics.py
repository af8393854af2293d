"""The numbers of a replay, as metrics.json holds them."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

from jaxtube.coordinates import KEYS, TO_DISPLAY
from jaxtube.experiments.replay.set_table import compare
from jaxtube.statistics.intervals import CONFIDENCE
from jaxtube.witness.examine import Witness
from jaxtube.witness.shares import QuotedPromise, Share, is_own_log, judge_promise
from jaxtube.witness.span_test import JUDGED, SpanTest
from jaxtube.witness.spans import KINDS


def metrics(witness: Witness, promise: QuotedPromise | None) -> dict[str, Any]:
    """Return the numbers of a replay."""
    share = witness.windows.share
    verdict = judge_promise(share, promise) if promise else None
    if is_own_log(promise, witness.findings.log.path):
        verdict = "none: the scenario was made of this log"
    return {
        "promised_share": promise.share if promise else None,
        "windows": _measure_share(share),
        "verdict_on_promise": verdict,
        "confidence": CONFIDENCE,
        "period": _measure_test(witness.period),
        "longer": _measure_test(witness.longer) if witness.longer else None,
        "not_compared": witness.sets if isinstance(witness.sets, str) else None,
        "sets": [
            {
                "name": one.name,
                "half_widths": _by_coordinate(one.half_widths * TO_DISPLAY),
                "share_inside": one.inside,
                "share_inside_alone": _by_coordinate(one.alone),
                "greatest_usage": one.usage,
            }
            for one in compare(witness)
        ],
        "poses_behind_wheels_s": witness.findings.clock.offset,
    }


def _measure_share(share: Share) -> dict[str, Any]:
    return {
        "inside": share.inside,
        "count": share.count,
        "commands_whole": share.whole,
        "commands": share.commands,
        "share_of_commands_interval": share.interval,
    }


def _measure_test(test: SpanTest) -> dict[str, Any]:
    kinds = {kind: int(test.every.is_kind(kind).sum()) for kind in KINDS}
    judged = {
        kind: _measure_share(test.share(kind))
        | {"inside_alone": _by_coordinate(test.inside_alone(kind))}
        for kind in JUDGED
    }
    return {
        "duration_s": float(np.median(test.spans.duration)),
        "spans": kinds,
        **judged,
        "refuted": int(test.verdict.refuted.sum()),
        "undecided": int(test.verdict.undecided.sum()),
        "greatest_usage": float(test.verdict.usage.max()),
        "noise_share": _by_coordinate(test.noise_share),
        "not_explained_s": [
            [float(test.spans.start[run[0]]), float(test.spans.end[run[-1]])]
            for run in test.stretches()
        ],
    }


def _by_coordinate(values: Float[np.ndarray, "3"]) -> dict[str, float]:
    return dict(zip(KEYS, values.tolist(), strict=True))
