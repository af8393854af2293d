"""How busy a GPU is and how much of its memory is taken, as `nvidia-smi` samples them.

Source: new; utilisation is the share of the sampling period in which some kernel ran.
"""

from __future__ import annotations

import shutil
import subprocess
import threading
import time
from typing import NamedTuple

QUERY = ("--query-gpu=utilization.gpu,memory.used", "--format=csv,noheader,nounits", "-i", "0")
MILLISECONDS = 200
"""Between two samples."""


class Sample(NamedTuple):
    """One line of `nvidia-smi`."""

    time: float  # time.perf_counter
    utilisation: float  # percent
    megabytes: float


def read_sample(line: str, now: float) -> Sample | None:
    """Return the sample of a line such as "97, 1234"; None where the driver does not say."""
    words = line.replace("%", "").replace("MiB", "").split(",")
    try:
        utilisation, megabytes = map(float, words)
    except ValueError:
        return None
    return Sample(now, utilisation, megabytes)


class Watch:
    """Samples of the first GPU, taken for as long as the context is open; none without a GPU."""

    def __init__(self):
        """Sample nothing yet."""
        self.samples: list[Sample] = []
        self._process: subprocess.Popen | None = None

    def __enter__(self) -> Watch:
        """Start to sample."""
        program = shutil.which("nvidia-smi")
        if program:
            words = [program, *QUERY, "-lms", str(MILLISECONDS)]
            quiet = subprocess.DEVNULL
            self._process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=quiet, text=True)
            threading.Thread(target=self._read, args=(self._process,), daemon=True).start()
        return self

    def __exit__(self, *_) -> None:
        """Stop sampling."""
        if self._process:
            self._process.terminate()

    def _read(self, process: subprocess.Popen) -> None:
        assert process.stdout
        for line in process.stdout:
            sample = read_sample(line, time.perf_counter())
            if sample:
                self.samples.append(sample)

    def mean_utilisation(self, begin: float, end: float) -> float | None:
        """Return the mean between two times of `time.perf_counter`, percent; None without a
        sample."""
        seen = [sample.utilisation for sample in self._within(begin, end)]
        return sum(seen) / len(seen) if seen else None

    def most_memory(self, begin: float, end: float) -> float | None:
        """Return the most memory taken between two times, MB; None without a sample."""
        return max((sample.megabytes for sample in self._within(begin, end)), default=None)

    def _within(self, begin: float, end: float) -> list[Sample]:
        return [sample for sample in list(self.samples) if begin <= sample.time <= end]
