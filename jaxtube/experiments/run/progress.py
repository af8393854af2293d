"""Progress of anything that takes more than moments: a bar in a terminal, a plain line now and then
elsewhere."""

import sys

from tqdm import tqdm

SECONDS_BETWEEN_LINES = 15.0


class _Lines:
    """A stream on which every update is a line of its own."""

    def write(self, text: str) -> None:
        if text.strip():
            sys.stderr.write(text.strip() + "\n")

    def flush(self) -> None:
        sys.stderr.flush()


def progress(total: int, title: str, unit: str, done: int = 0) -> tqdm:
    """Return a tqdm bar on the standard error that counts `total` units, `done` of which an earlier
    run did."""
    if sys.stderr.isatty():
        return tqdm(total=total, initial=done, desc=title, unit=f" {unit}", mininterval=0.2)
    line = f"{title}: {{n_fmt}} of {{total_fmt}} {unit}, {{rate_fmt}}, {{elapsed}} gone, {{remaining}} left{{postfix}}"
    return tqdm(
        total=total,
        initial=done,
        unit=f" {unit}",
        mininterval=SECONDS_BETWEEN_LINES,
        bar_format=line,
        file=_Lines(),
    )
