"""Paths made for tests, as files: each way in which a recording or a plan can be awkward."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float

SPACING = 1e-3
"""Of the points of a drive before it is sampled, m."""

BENDS = ((4, 0, 0), (1, 0, 0.35), (5, 0.35, 0.35), (1, 0.35, 0), (3, 0, 0), (1, 0, -0.3))
BENDS = (*BENDS, (6, -0.3, -0.3), (1, -0.3, 0), (2, 0, 0))
"""A drive with two bends: lengths in m, curvatures in 1/m at their beginnings and ends."""

HAIRPIN = ((5, 0, 0), (0.5, 0, 1.2), (np.pi / 1.2 - 0.5, 1.2, 1.2), (0.5, 1.2, 0), (5, 0, 0))

Drive = tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]
"""Times s, positions m, headings rad."""


def drive(bends=BENDS, speed=1.0, rate=10.0) -> Drive:
    """Drive along bends at a speed (m/s), a row at each 1 / rate s."""
    pieces = [np.linspace(a, b, round(length / SPACING)) for length, a, b in bends]
    headings = SPACING * np.cumsum(np.concatenate(pieces))
    points = SPACING * np.cumsum(np.exp(1j * headings))
    every = round(speed / rate / SPACING)
    shown = points[::every]
    positions = np.column_stack([shown.real, shown.imag])
    return np.arange(len(shown)) / rate, positions, headings[::every]


def stand(made: Drive, row: int, seconds: float, rate=10.0) -> Drive:
    """Let the drive stand at a row for a while."""
    time, positions, headings = made
    rows = np.concatenate([np.arange(row), np.full(round(seconds * rate), row)])
    rows = np.concatenate([rows, np.arange(row, len(time))])
    return np.arange(len(rows)) / rate, positions[rows], headings[rows]


def circle(radius=3.0, speed=1.0, turns=1.0) -> Drive:
    """Drive around a circle, ten rows a second."""
    way = np.arange(0.0, turns * 2.0 * np.pi * radius, speed / 10.0)
    angle = way / radius
    positions = radius * np.column_stack([np.sin(angle), 1.0 - np.cos(angle)])
    return way / speed, positions, angle


def eight(radius=3.0) -> Drive:
    """Drive Bernoulli's lemniscate of a least radius once, at about 1 m/s."""
    angle = np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False)
    half = 3.0 * radius
    scale = half / (1.0 + np.sin(angle) ** 2)
    positions = np.column_stack([scale * np.cos(angle), scale * np.sin(angle) * np.cos(angle)])
    steps = np.linalg.norm(np.diff(positions, axis=0, append=positions[:1]), axis=1)
    return np.append(0.0, np.cumsum(steps)[:-1]), positions, np.zeros(200)


def there_and_back(turning: bool) -> Drive:
    """Drive 6 m and the same way back: turned on the spot by 180 deg, or in reverse."""
    _, positions, headings = drive(((6, 0, 0.1),))
    back = headings[::-1][1:] + (np.pi if turning else 0.0)
    there = np.concatenate([positions, positions[::-1][1:]])
    both = np.concatenate([headings, back])
    return np.arange(len(both)) / 10.0, there, both


def corner() -> Drive:
    """Drive 5 m along the x axis, turn by 90 deg on the spot, and 5 m along the y axis."""
    along = np.arange(0.0, 5.0, 0.1)
    zeros = np.zeros_like(along)
    positions = np.concatenate(
        [np.column_stack([along, zeros]), np.column_stack([zeros + 5.0, along])]
    )
    headings = np.repeat([0.0, np.pi / 2.0], len(along))
    return np.arange(len(headings)) / 10.0, positions, headings


def add_noise(made: Drive, deviation: float, seed=1) -> Drive:
    """Add normal noise of a standard deviation (m) to either coordinate."""
    time, positions, headings = made
    noise = np.random.default_rng(seed).normal(size=positions.shape)
    return time, positions + deviation * noise, headings


def take(made: Drive, rows) -> Drive:
    """Return some rows of a drive."""
    time, positions, headings = made
    return time[rows], positions[rows], headings[rows]


def text_of(made: Drive, columns=("time_s", "x_m", "y_m"), delimiter=",", header=True) -> str:
    """Return a drive as a table."""
    time, positions, headings = made
    values = {"time_s": time, "x_m": positions[:, 0], "y_m": positions[:, 1], "yaw_rad": headings}
    rows = np.column_stack([values[column] for column in columns])
    lines = [delimiter.join(f"{value:.6f}" for value in row) for row in rows]
    return "\n".join([*([delimiter.join(columns)] if header else []), *lines, ""])


def repeat(made: Drive) -> Drive:
    """Write each third row twice."""
    rows = np.arange(len(made[0]))
    return take(made, np.sort(np.concatenate([rows, rows[::3]])))


def shuffle(made: Drive) -> Drive:
    """Write ten rows in reverse order."""
    rows = np.arange(len(made[0]))
    rows[50:60] = rows[59:49:-1]
    return take(made, rows)


def far_away(made: Drive) -> Drive:
    """Return a drive in UTM coordinates, stamped in 2023."""
    time, positions, headings = made
    return time + 1.7e9, positions + np.array([500123.456, 4649776.224]), headings


POSES = ("time_s", "x_m", "y_m", "yaw_rad")

MADE: dict[str, Callable[[], str | bytes]] = {
    "stops": lambda: text_of(stand(drive(), 80, 5.0)),
    "duplicates": lambda: text_of(repeat(drive())),
    "unordered": lambda: text_of(shuffle(drive())),
    "no_time": lambda: text_of(drive(), ("x_m", "y_m")),
    "semicolons": lambda: text_of(drive(), delimiter=";"),
    "byte_order_mark": lambda: b"\xef\xbb\xbf" + text_of(drive()).encode(),
    "carriage_returns": lambda: text_of(drive()).replace("\n", "\r\n").encode(),
    "no_header": lambda: text_of(drive(), header=False),
    "utm": lambda: text_of(far_away(drive())),
    "closed": lambda: text_of(add_noise(circle(), 0.01)),
    "figure_eight": lambda: text_of(eight()),
    "hairpin": lambda: text_of(drive(HAIRPIN)),
    "gnss": lambda: text_of(add_noise(drive(), 0.02)),
    "slow_gnss": lambda: text_of(add_noise(drive(speed=0.3), 0.02)),
    "reversal": lambda: text_of(there_and_back(turning=False)),
    "reversal_with_headings": lambda: text_of(there_and_back(turning=False), POSES),
    "turned_about": lambda: text_of(there_and_back(turning=True), POSES),
    "corner": lambda: text_of(corner()),
    "noisy_corner": lambda: text_of(add_noise(corner(), 0.02)),
}
"""Files by their names."""


def write_made(folder: Path, name: str) -> Path:
    """Write a made path into a folder; return its file."""
    content = MADE[name]()
    file = folder / f"{name}.csv"
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    return file
