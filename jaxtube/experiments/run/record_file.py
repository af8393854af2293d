"""One record of a long run as bytes: they tell whether they are whole, and which run they belong
to.

record sha256 DIGEST     of all that follows
{"identity": ..}         the header, one line of JSON
npz                      the statistics, compressed
"""

import hashlib
import io
import json
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from jaxtube.numpy_archive import read_archive

SHOWN_KEYS = 3
SHOWN_CHARACTERS = 24
"""Of a difference between two runs, in a message."""

Arrays = dict[str, np.ndarray]


class DamagedError(Exception):
    """Bytes that are not, or are no longer, what was once written."""


def encode(header: Mapping[str, Any], statistics: Mapping[str, Any]) -> bytes:
    """Write a record; equal headers and statistics give equal bytes.

    Raises:
        ValueError: for statistics that are neither integers nor floats.
    """
    payload = io.BytesIO()
    arrays: dict[str, Any] = plain(statistics)
    np.savez_compressed(payload, **arrays)
    content = json.dumps(header, sort_keys=True).encode() + b"\n" + payload.getvalue()
    return _seal(content) + content


def decode(record: bytes) -> tuple[dict[str, Any], Arrays]:
    """Return the header and the statistics of a record.

    Raises:
        DamagedError: when any byte differs from what was written, or what was written is no record.
    """
    seal, newline, content = record.partition(b"\n")
    if seal + newline != _seal(content):
        raise DamagedError
    header, _, payload = content.partition(b"\n")
    try:
        table = json.loads(header)
        arrays = read_archive(payload)
    except (ValueError, RecursionError):
        raise DamagedError from None
    if not isinstance(table, dict):
        raise DamagedError
    return table, arrays


def plain(statistics: Mapping[str, Any]) -> Arrays:
    """Return statistics as arrays by sorted name.

    Raises:
        ValueError: for what is neither integers nor floats.
    """
    arrays = {name: np.asarray(statistics[name]) for name in sorted(statistics)}
    for name, array in arrays.items():
        if array.dtype.kind not in "biuf":
            raise ValueError(
                f"statistic {name}: {array.dtype} is neither integers nor floats; convert it"
            )
    return arrays


def differences(there: Any, here: Any) -> str:
    """Name the first dotted keys in which two JSON values differ, with both values; empty when they
    are equal."""
    first = dict(_leaves(there))
    second = dict(_leaves(here))
    keys = [key for key in second | first if second.get(key) != first.get(key)]
    shown = [
        f"{key} = {_shorten(first.get(key))} there, {_shorten(second.get(key))} here"
        for key in keys[:SHOWN_KEYS]
    ]
    if len(keys) > SHOWN_KEYS:
        shown.append(f"and {len(keys) - SHOWN_KEYS} more")
    return "; ".join(shown)


def _seal(content: bytes) -> bytes:
    return f"record sha256 {hashlib.sha256(content).hexdigest()}\n".encode()


def _leaves(value: Any, key: str = "") -> Iterator[tuple[str, str]]:
    """Yield the values inside tables and lists as JSON, by dotted key."""
    entries = dict(enumerate(value)) if isinstance(value, list) else value
    if not isinstance(entries, dict) or not entries:
        yield key, json.dumps(value, ensure_ascii=False)
        return
    for name, entry in entries.items():
        yield from _leaves(entry, f"{key}.{name}" if key else str(name))


def _shorten(text: str | None) -> str:
    if text is None:
        return "absent"
    return text if len(text) <= SHOWN_CHARACTERS else text[: SHOWN_CHARACTERS - 3] + "..."
