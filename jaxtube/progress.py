"""Progress of anything that takes more than moments: a bar in a terminal, a plain line now and then
elsewhere.

The first units take the time of compilation as well: until they are done "compiling" is shown, and
the time left is estimated from there on.
"""

import sys
import time
from collections.abc import Mapping, MutableMapping
from typing import Any

from tqdm import tqdm

SECONDS_BETWEEN_LINES = 15.0
SECONDS_BETWEEN_DRAWINGS = 0.2
LINE = "{desc}: {n_fmt} of {total_fmt}{unit}{times}{postfix}"
BAR = "{l_bar}{bar}| {n_fmt} of {total_fmt}{unit}{times}{postfix}"


def announce(work: str) -> None:
    """Say in one line on the standard error what is waited for from here on."""
    print(f"{work} ...", file=sys.stderr, flush=True)


class ProgressBar(tqdm):
    """A bar whose clock starts with its first units."""

    starting: str
    """What is shown until then, such as "compiling"; empty once they are done."""

    @property
    def format_dict(self) -> MutableMapping[str, Any]:
        """What the bar shows; nothing of speed and time before the first units."""
        shown = super().format_dict
        shown["times"] = self._describe_times(shown)
        if getattr(self, "starting", ""):
            shown["bar_format"] = f"{{desc}}: {self.starting}"
        return shown

    def _describe_times(self, shown: Mapping[str, Any]) -> str:
        """Return speed, time gone and time left in words; empty while no speed is known."""
        elapsed = shown["elapsed"]
        rate = shown["rate"]
        if not rate and elapsed > 0:
            rate = (shown["n"] - shown["initial"]) / elapsed
        if not rate:
            return ""
        speed = f"{rate:.2f}{shown['unit']}/s" if rate >= 1 else f"{1 / rate:.2f} s each"
        gone = self.format_interval(elapsed)
        left = self.format_interval((shown["total"] - shown["n"]) / rate)
        return f", {speed}, {gone} gone, {left} left"

    def update(self, n: float | None = 1) -> bool | None:
        """Count units; the first ones start the clock."""
        if not self.starting:
            return super().update(n)
        self.starting = ""
        self.n += n or 0
        self.initial = self.n
        self.last_print_n = self.n
        self.start_t = time.time()  # tqdm's own clock
        self.last_print_t = self.start_t
        return self.refresh()


class _Lines:
    """A stream on which every update is a line of its own."""

    def write(self, text: str) -> None:
        if text.strip():
            sys.stderr.write(text.strip() + "\n")

    def flush(self) -> None:
        sys.stderr.flush()


def progress(
    total: int, title: str, unit: str, done: int = 0, starting: str = "compiling"
) -> ProgressBar:
    """Return a bar on the standard error.

    Args:
        total: units in all.
        title: of the work, a participle.
        unit: plural.
        done: units that an earlier run did.
        starting: what is shown until the first units are done.
    """
    settings = {"total": total, "initial": done, "desc": title, "unit": f" {unit}", "delay": 1e-9}
    if sys.stderr.isatty():
        bar = ProgressBar(**settings, mininterval=SECONDS_BETWEEN_DRAWINGS, bar_format=BAR)
    else:
        bar = ProgressBar(
            **settings, mininterval=SECONDS_BETWEEN_LINES, bar_format=LINE, file=_Lines()
        )
    bar.starting = starting
    bar.refresh()
    return bar


def show_progress(total: int, title: str, unit: str) -> ProgressBar:
    """Return a bar on the standard error where that is a terminal, else one that shows nothing; for
    the functions of the library, arguments as for `progress`."""
    if sys.stderr.isatty():
        return progress(total, title, unit)
    bar = ProgressBar(total=total, disable=True)
    bar.starting = ""
    return bar
