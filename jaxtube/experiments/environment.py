"""What the process of a command needs before JAX is imported, and where it ends."""

import gc
import hashlib
import importlib.metadata
import io
import multiprocessing
import os
import platform
import signal
import socket
import sys
import threading
import time
from pathlib import Path
from typing import NoReturn

PIECES = 8
"""Pieces of a program that are compiled side by side."""

ALLOCATIONS = 100_000
"""Objects made between two searches for garbage."""

GRACE_SECONDS = 3.0
"""Time that the main thread has to end by itself after Ctrl-C."""


def use_float64() -> None:
    """Compute in float64."""
    os.environ["JAX_ENABLE_X64"] = "1"


def compile_quickly() -> None:
    """Let XLA compile a program in a few pieces, side by side: it splits it over 32, which takes
    longer on few processors. Let it emit fused loops as LLVM IR at once: that takes a third less,
    and they run as fast. Two branches of a program may then round the same sum otherwise."""
    # An unknown flag is fatal, so they are passed only to the releases that were seen to know them.
    if importlib.metadata.version("jaxlib").startswith("0.10."):
        pieces = f"--xla_cpu_parallel_codegen_split_count={PIECES}"
        add_xla_flags(pieces, "--xla_cpu_use_fusion_emitters=false")


def add_xla_flags(*flags: str) -> None:
    """Pass flags to XLA that are not passed already; those that are come last, where they count.

    Processes inherit them, and a compiled program is found again by flags that are the same, word
    by word.
    """
    given = os.environ.get("XLA_FLAGS", "").split()
    missing = [flag for flag in flags if flag not in given]
    os.environ["XLA_FLAGS"] = " ".join([*missing, *given])


def use_one_thread_for_linear_algebra() -> None:
    """Let matrices, which are small off line, be factorised by one thread: others wait for it in a
    loop, on the processor that compiles meanwhile."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def keep_compiled_programs(home: Path | None = None) -> None:
    """Keep compiled programs in a folder, which spares a command half a minute the next time.

    A program fits the processor it was compiled for, and homes are shared between machines: one
    folder for each kind.

    Args:
        home: of these folders; the user's cache where none is given.
    """
    users = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxtube"
    features = sorted(_find_processor_features())
    kind = hashlib.sha256(f"{platform.machine()} {features}".encode()).hexdigest()[:16]
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str((home or users) / kind))
    # Small ones too: there are a hundred, and each takes longer to compile than to read.
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")


def search_garbage_rarely() -> None:
    """Let Python look for unreachable objects rarely: while a program is traced nearly all objects
    stay, and a tenth of the time went into going through them."""
    gc.set_threshold(ALLOCATIONS, *gc.get_threshold()[1:])


def print_any_character() -> None:
    """Let a report reach a terminal that lacks one of its characters: the character is escaped."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def end_after_interrupt(line: str, code: int) -> None:
    """Let Ctrl-C end the process within GRACE_SECONDS, whatever the main thread does.

    The main thread sees an interrupt only between two instructions of Python: a compiled program
    runs on, and a callback of a library may swallow the exception.

    Args:
        line: what is then printed on the standard error.
        code: the exit code.
    """
    reader, writer = socket.socketpair()
    writer.setblocking(False)
    signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)

    def watch(writer: socket.socket) -> None:
        while signal.SIGINT not in reader.recv(1):
            continue
        time.sleep(GRACE_SECONDS)
        print(line, file=sys.stderr)
        leave(code)

    # The thread holds the writer too: it would be closed with the last reference.
    threading.Thread(target=watch, args=(writer,), daemon=True).start()


def leave(code: int) -> NoReturn:
    """End the process and its children at once.

    Not by `sys.exit`: the threads of a device may still run a program, and they crash when the
    interpreter takes down what they use. Files are complete at any time, or not there.
    """
    for child in multiprocessing.active_children():
        child.terminate()
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            continue
    os._exit(code)


def _find_processor_features() -> set[str]:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    return {line for line in lines if line.startswith(("flags", "Features"))}  # x86, ARM
