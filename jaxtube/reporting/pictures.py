"""Figures made small enough to travel inside a page."""

from __future__ import annotations

import base64
import io

from PIL import Image

COLOURS = 255
"""Of a picture in a page: lines, fills and their soft edges need fewer."""


def embed(png: bytes, most_bytes: int) -> str:
    """Return a picture as the address of an image that holds its own data; "" for one that stays
    larger than allowed.

    Args:
        png: the picture.
        most_bytes: it may take in the page.
    """
    for scale in (1.0, 0.6):
        address = f"data:image/png;base64,{base64.b64encode(_shrink(png, scale)).decode()}"
        if len(address) <= most_bytes:
            return address
    return ""


def size(png: bytes) -> tuple[int, int]:
    """Return width and height in pixels."""
    return Image.open(io.BytesIO(png)).size


def _shrink(png: bytes, scale: float) -> bytes:
    """Return the picture on white with few colours, scaled."""
    picture = Image.open(io.BytesIO(png)).convert("RGBA")
    paper = Image.new("RGBA", picture.size, "white")
    flat = Image.alpha_composite(paper, picture).convert("RGB")
    if scale != 1:
        flat = flat.resize((round(flat.width * scale), round(flat.height * scale)))
    file = io.BytesIO()
    few = flat.quantize(COLOURS, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    few.save(file, format="png", optimize=True)
    return file.getvalue()
