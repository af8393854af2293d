"""Figures made small enough to travel inside a page, without a change to any of their colours."""

from __future__ import annotations

import base64
import io

from PIL import Image, features

SCALES = (1.0, 0.6)
"""By which a picture is shrunk, until it fits."""
EFFORT = 2
"""Of the compression, 0 to 6: more takes longer, and saves little."""


def embed(png: bytes, most_bytes: int) -> str:
    """Return a picture as the address of an image that holds its own data; "" for one that stays
    larger than allowed.

    Args:
        png: the picture.
        most_bytes: it may take in the page.
    """
    for scale in SCALES:
        kind, data = _compress(png, scale)
        address = f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
        if len(address) <= most_bytes:
            return address
    return ""


def size(png: bytes) -> tuple[int, int]:
    """Return width and height in pixels."""
    return Image.open(io.BytesIO(png)).size


def _compress(png: bytes, scale: float) -> tuple[str, bytes]:
    """Return the picture on white, scaled, in the smaller of the formats that lose nothing."""
    picture = Image.open(io.BytesIO(png)).convert("RGBA")
    paper = Image.new("RGBA", picture.size, "white")
    flat = Image.alpha_composite(paper, picture).convert("RGB")
    if scale != 1:
        flat = flat.resize((round(flat.width * scale), round(flat.height * scale)))
    file = io.BytesIO()
    if features.check("webp"):
        flat.save(file, format="webp", lossless=True, method=EFFORT)
        return "webp", file.getvalue()
    flat.save(file, format="png", optimize=True)
    return "png", file.getvalue()
