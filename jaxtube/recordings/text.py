"""The text of a file, whatever program wrote it.

Spreadsheets on Windows save "Unicode text" as UTF-16 and CSV in the code page of the country;
robots write UTF-8. Numbers are ASCII in all of them: a wrong code page can spoil names only.

Source: The Unicode Standard 15.0, 2.6 and 23.8 (encoding schemes, byte order marks).
"""

from __future__ import annotations

import codecs
import re
from pathlib import Path
from typing import NamedTuple

BYTE_ORDER_MARKS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)

SIGNATURES = (
    (b"PK\x03\x04", "a workbook or zip archive"),
    (b"\xd0\xcf\x11\xe0", "a workbook"),
    (b"\x1f\x8b", "compressed by gzip"),
    (b"BZh", "compressed by bzip2"),
    (b"\x28\xb5\x2f\xfd", "compressed by zstd"),
    (b"\x89HDF", "an HDF5 file"),
    (b"MATLAB", "a MATLAB file"),
)
"""First bytes of files that are taken for tables by mistake, and what they are."""

INSPECTED_BYTES = 4096
"""From the start of a file, to tell its encoding."""

SHARE_OF_ZEROS = 0.4
"""Least share of zeros among every second byte of UTF-16; digits and commas have all of them."""

CONTROL_CHARACTERS = re.compile("[\x00-\x08\x0e-\x1b\x7f]")
"""None of them occurs in a table."""


class Text(NamedTuple):
    """The text of a file and what was guessed to read it."""

    content: str
    guesses: tuple[str, ...]


def read_text(path: str | Path) -> Text:
    """Read a file as text: UTF-8 or UTF-16 with or without byte order mark, else Latin-1.

    Raises:
        ValueError: in one line, for a file that cannot be read or is no text.
    """
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror}); name a file") from None
    for signature, kind in SIGNATURES:
        if data.startswith(signature):
            raise ValueError(f"{path}: is {kind}; unpack it, or save it as CSV")
    mark, encoding = _find_encoding(data)
    try:
        text = Text(data[len(mark) :].decode(encoding), ())
    except UnicodeDecodeError:
        text = Text(data.decode("latin-1"), ("text in Latin-1, for it is not UTF-8",))
    if CONTROL_CHARACTERS.search(text.content):
        raise ValueError(f"{path}: is not text; give a table as CSV in UTF-8")
    return text


def _find_encoding(data: bytes) -> tuple[bytes, str]:
    """Return the byte order mark, empty without one, and the name of the encoding."""
    for mark, encoding in BYTE_ORDER_MARKS:
        if data.startswith(mark):
            return mark, encoding
    head = data[:INSPECTED_BYTES]
    half = max(len(head) // 2, 1)
    if head[1::2].count(0) > SHARE_OF_ZEROS * half:
        return b"", "utf-16-le"
    if head[0::2].count(0) > SHARE_OF_ZEROS * half:
        return b"", "utf-16-be"
    return b"", "utf-8"
