"""Moving pictures in files: GIF, or MP4 where ffmpeg is there."""

from __future__ import annotations

import contextlib
import shutil
import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import matplotlib
from PIL import Image

from jaxtube.atomic import write_atomically
from jaxtube.figures.style import SETTINGS
from jaxtube.reporting.animation import DPI, SIZE, draw_frames
from jaxtube.reporting.laps import StoredLaps

FRAMES_PER_SECOND = 15
COLOURS = 48
"""Of a GIF: one palette for all of its pictures, so that what stands still does not flicker."""


def save_animation(stored: StoredLaps, places: Mapping[str, int], frames: int, path: Path) -> None:
    """Write a lap of one or several controllers as GIF or, with ffmpeg, as MP4.

    Args:
        stored: laps of a run.
        places: by controller's name, which of its laps is drawn; limits are those of the first.
        frames: pictures, at equal distances from the first to the last instant.
        path: of the file; its ending decides.

    Raises:
        ValueError: one line, for another ending, or MP4 without ffmpeg.
    """
    write = {".gif": _write_gif, ".mp4": _write_mp4}.get(path.suffix.lower())
    if write is None:
        raise ValueError("has an unknown ending; end it in .gif or .mp4")
    if path.suffix.lower() == ".mp4" and shutil.which("ffmpeg") is None:
        raise ValueError("needs ffmpeg, which is not installed; install it, or end it in .gif")
    with matplotlib.rc_context(SETTINGS):
        write(draw_frames(stored, places, frames), path)


def _write_gif(pictures: Iterator[Image.Image], path: Path) -> None:
    drawn = list(pictures)
    palette = drawn[len(drawn) // 2].quantize(COLOURS, method=Image.Quantize.MEDIANCUT)
    few = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in drawn]
    options = {"save_all": True, "append_images": few[1:], "loop": 0, "optimize": True}
    duration = round(1000 / FRAMES_PER_SECOND)
    write_atomically(
        path, lambda file: few[0].save(file, format="gif", duration=duration, **options)
    )


def _write_mp4(pictures: Iterator[Image.Image], path: Path) -> None:
    width = round(SIZE[0] * DPI)
    height = round(SIZE[1] * DPI)
    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}"]
    given = ["ffmpeg", "-loglevel", "error", "-y", *raw, "-r", str(FRAMES_PER_SECOND), "-i", "-"]
    coded = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-movflags", "+faststart", "-f", "mp4"]

    def write(file: Any) -> None:
        with subprocess.Popen([*given, *coded, file.name], stdin=subprocess.PIPE) as coder:
            assert coder.stdin is not None
            # Where ffmpeg has ended before, its exit status says so.
            with contextlib.suppress(BrokenPipeError):
                for picture in pictures:
                    coder.stdin.write(picture.tobytes())
                coder.stdin.close()
            if coder.wait():
                raise ValueError("could not be written by ffmpeg; end it in .gif")

    write_atomically(path, write)
