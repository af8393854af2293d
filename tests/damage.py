"""Files as disks, editors and strangers damage them, and what reading them may not do."""

import contextlib
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from hypothesis import strategies as st

TOKENS = (
    b"nan",
    b"-inf",
    b"1e999",
    b"-1",
    b"1e-320",
    b"9" * 400,
    b"",
    b"\0",
    b"\xff\xfe",
    b"\xef\xbb\xbf",
    b'"',
    b"'''",
    b"[[",
    b"]",
    b"{",
    b"= {a = 1}",
    b"\n",
    b"\r",
    b"\n[controller]\n",
    b",",
    b";",
    b"\t",
    b"../../outside",
    b"/outside",
    b"$(touch outside)",
    b"__import__('os').system('touch outside')",
    "٣".encode(),
    b"1_0",
    b"0x10",
    b"true",
)
"""What is written into files: numbers that are none, delimiters, paths that lead out, code."""

FORBIDDEN = (
    "pickle.find_class",
    "os.system",
    "os.exec",
    "os.posix_spawn",
    "os.remove",
    "os.rename",
    "os.rmdir",
    "os.mkdir",
    "os.symlink",
    "os.link",
    "shutil.rmtree",
    "subprocess.Popen",
    "socket.connect",
)
"""Events of the interpreter that nothing which only reads causes."""

_watched: list[str] | None = None


def _watch(event: str, arguments: tuple) -> None:
    if _watched is None:
        return
    if event in FORBIDDEN:
        _watched.append(f"{event} {arguments}")
    if event == "open" and isinstance(arguments[1], str) and set(arguments[1]) & set("wax+"):
        _watched.append(f"{event} {arguments}")


sys.addaudithook(_watch)


@contextlib.contextmanager
def only_reading() -> Iterator[None]:
    """Fail where code of a file is run, or a file is written, renamed or removed."""
    global _watched
    _watched = []
    try:
        yield
        assert _watched == []
    finally:
        _watched = None


def is_one_line(error: BaseException) -> bool:
    """Say whether an error is told in one line that says something."""
    text = str(error)
    return bool(text.strip()) and len(text.splitlines()) == 1


@st.composite
def damaged(draw: st.DrawFn, corpus: Sequence[bytes]) -> bytes:
    """Draw a file of a corpus with up to four damages, mostly one."""
    data = draw(st.sampled_from(corpus))
    for _ in range(draw(st.sampled_from([1, 1, 1, 2, 4]))):
        start = draw(st.integers(0, len(data)))
        stop = min(len(data), start + draw(st.integers(0, 24)))
        kind = draw(st.sampled_from(["flip", "write", "cut", "insert", "repeat", "drop", "splice"]))
        if kind == "flip" and start < len(data):
            bit = 1 << draw(st.integers(0, 7))
            data = data[:start] + bytes([data[start] ^ bit]) + data[start + 1 :]
        elif kind == "write":
            data = data[:start] + draw(st.sampled_from(TOKENS)) + data[stop:]
        elif kind == "insert":
            data = data[:start] + draw(st.binary(max_size=8)) + data[start:]
        elif kind == "cut":
            data = data[:start]
        elif kind == "repeat":
            data = data[:stop] + data[start:stop] * draw(st.integers(1, 3)) + data[stop:]
        elif kind == "drop":
            data = data[:start] + data[stop:]
        elif kind == "splice":
            other = draw(st.sampled_from(corpus))
            data = data[:start] + other[draw(st.integers(0, len(other))) :]
    return data


def list_files(folder: Path) -> dict[str, bytes]:
    """Return all files below a folder with their content, by path."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }
