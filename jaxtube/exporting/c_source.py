"""Constants of an exported controller as C99: exact numbers, sizes, and their hash."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from jaxtube.exporting.constants import Constants
from jaxtube.exporting.templating import render

INPUT_MAPS = ("paper", "cosine_free", "x_exact")
"""By their numbers in C."""
PROGRAM = (
    "rows",
    "row_errors",
    "lower",
    "upper",
    "whitened",
    "unwhiten",
    "free_inputs",
    "start",
)
"""Members of a `jaxtube_program`, in order."""
MODEL = ("tube_gain", "terminal_gain", "transition", "input_matrix", "farthest")
"""Members of a `jaxtube_model`."""
NUMBERS = (
    "caps",
    "wheel_limits",
    "nominal_slip",
    "slip_limits",
    "observer_gain",
    "dt",
    "track_width",
    "lag",
    "delay_rest",
    "most_age",
    "most_jitter",
    "certified_time",
)
"""Members of `jaxtube_numbers`, before the tolerances."""
TOLERANCES = ("tolerance", "row_tolerance", "dependent", "unmoved")
"""The last members of `jaxtube_numbers`."""
FNV_START = 14695981039346656037
FNV_PRIME = 1099511628211
WORD = 2**64
LINE = 100
"""Characters of a line."""


def render_header(constants: Constants, title: str, verdict: str, certificate_sha256: str) -> str:
    """Return constants.h.

    Args:
        constants: of either precision.
        title: of the design, in words.
        verdict: of its certificate.
        certificate_sha256: of the file that holds it.
    """
    m, n = constants.rows.shape[1:]
    return render(
        "constants.h.jinja",
        title=_comment(title),
        verdict=_comment(verdict),
        certificate_sha256=certificate_sha256,
        windows=len(constants.rows),
        horizon=constants.horizon,
        inputs=n,
        rows=m,
        steps=len(constants.window),
        **_list_choices(constants),
        most_operations=count_operations(constants),
    )


def render_source(
    doubles: Constants, floats: Constants | None, title: str, certificate_sha256: str
) -> str:
    """Return constants.c; without constants for floats, that build is refused by the compiler."""
    refusal = "#error this controller is not certified with quadratic programs in floats"
    return render(
        "constants.c.jinja",
        title=_comment(title),
        of_doubles=_render_precision(doubles, certificate_sha256),
        of_floats=_render_precision(floats, certificate_sha256) if floats else refusal,
        models=_braces([[getattr(doubles, name)[i] for name in MODEL] for i in _windows(doubles)]),
        references=_braces(
            list(zip(doubles.reference_wheels, doubles.reference_poses, strict=True))
        ),
        window_of=_braces(doubles.window),
    )


def count_operations(constants: Constants) -> int:
    """Return a bound on the operations of floating point in a plan of controller.c.

    It is that of `most_exchanges` exchanges with as many active rows as there are inputs, each of
    which lets a row leave and factors all anew.
    """
    m, n = constants.rows.shape[1:]
    solve = 2 * n * n + n
    pull = n * (2 * n + 2)
    check = m * (2 * n + 2)
    begin = m * (6 + 2) + n * (6 + 6)
    factor = sum(2 * n + 2 * j + 4 for i in range(n) for j in range(i + 1))
    way = 2 * n * n + solve + pull + 2 * n * 5 + 3 * n + 8 * n + 10
    refute = n * (2 * n + 6) + 4
    move = 2 * (n * (4 * n + 3) + solve + pull) + n * (2 * n + 1)
    return begin + 2 * check + constants.most_exchanges * (check + way + factor) + refute + move


def _list_choices(constants: Constants) -> dict[str, int]:
    """Return what the preprocessor of C chooses by."""
    return {
        "is_certified": int(constants.is_certified),
        "delay_periods": constants.delay_periods,
        "restarts": int(constants.restarts),
        "needs_slip": int(constants.needs_slip),
        "remembers_wheels": int(constants.remembers_wheels),
        "input_map": INPUT_MAPS.index(constants.input_map),
        "most_exchanges": constants.most_exchanges,
    }


def hash_constants(constants: Constants, certificate_sha256: str) -> int:
    """Return the FNV-1a hash of the digest of the certificate and of the bits of all numbers, each
    as a double, in the order of C."""
    value = FNV_START
    numbers = [*map(ord, certificate_sha256), *_list_choices(constants).values()]
    for byte in np.array([*numbers, *_chain(constants)], float).tobytes():
        value = (value ^ byte) * FNV_PRIME % WORD
    return value


def _chain(constants: Constants) -> Iterator[float]:
    """Yield all numbers in the order in which they lie in C."""
    for index in _windows(constants):
        for name in PROGRAM:
            yield from getattr(constants, name)[index].ravel().tolist()
    for index in _windows(constants):
        for name in MODEL:
            yield from getattr(constants, name)[index].ravel().tolist()
    yield from np.hstack([constants.reference_wheels, constants.reference_poses]).ravel().tolist()
    for number in _numbers(constants):
        yield from np.ravel(number).tolist()
    yield from constants.window.astype(float).tolist()


def _numbers(constants: Constants) -> list:
    numbers = [getattr(constants, name) for name in NUMBERS]
    return numbers + [getattr(constants.precision, name) for name in TOLERANCES]


def _windows(constants: Constants) -> range:
    return range(len(constants.rows))


def _render_precision(constants: Constants, certificate_sha256: str) -> str:
    """Return the definitions that depend on the precision."""
    suffix = "f" if constants.precision.name == "float32" else ""
    programs = [[getattr(constants, name)[i] for name in PROGRAM] for i in _windows(constants)]
    limits = _braces(_numbers(constants))
    digest = hash_constants(constants, certificate_sha256)
    return (
        "const jaxtube_program jaxtube_programs[JAXTUBE_WINDOWS] = "
        f"{_braces(programs, suffix)};\n\n"
        f"const jaxtube_numbers jaxtube_limits = {limits};\n\n"
        f"const uint64_t jaxtube_constants_hash = UINT64_C({digest});"
    )


def _braces(values, suffix: str = "") -> str:
    """Return nested values as an initialiser."""
    if isinstance(values, np.ndarray) and values.ndim == 1:
        return _fold([_number(value, suffix) for value in values.tolist()])
    if isinstance(values, np.ndarray | list | tuple):
        return "{" + ",\n".join(_braces(value, suffix) for value in values) + "}"
    return _number(values, suffix)


def _number(value: float | int, suffix: str) -> str:
    """Return a number that C reads back to the bit."""
    if isinstance(value, int):
        return str(value)
    if np.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    return f"{value.hex()}{suffix}"


def _fold(words: Iterable[str]) -> str:
    """Return words in braces, folded to lines."""
    lines = [""]
    for word in words:
        if len(lines[-1]) + len(word) + 2 > LINE:
            lines.append("")
        lines[-1] += f"{word}, "
    return "{" + "\n".join(line.rstrip() for line in lines).rstrip(",") + "}"


def _comment(text: str) -> str:
    """Return text that cannot end a comment of C."""
    return " ".join(text.split()).replace("*/", "* /").replace("\\", "/")
