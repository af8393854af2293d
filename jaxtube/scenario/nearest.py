"""What was probably meant by a word that is not known: the known ones nearest to it."""

import difflib
from collections.abc import Iterable

LEAST_SIMILARITY = 0.6
"""Twice the letters in common over all letters of both words, from which on one may be meant."""


def find_nearest(word: str, known: Iterable[str]) -> list[str]:
    """Return the known words most similar to another, all where several are alike; none where none
    is similar. Small and capital letters, and hyphens and underscores, are alike."""
    found: dict[float, list[str]] = {}
    for name in known:
        match = difflib.SequenceMatcher(None, _fold(word), _fold(name))
        found.setdefault(match.ratio(), []).append(name)
    best = max(found, default=0.0)
    return found[best] if best >= LEAST_SIMILARITY else []


def _fold(word: str) -> str:
    return word.lower().replace("-", "_")


def ask_if_meant(names: Iterable[str]) -> str:
    """Return the question whether one of some words was meant; empty without any."""
    asked = " or ".join(names)
    return f"did you mean {asked}?" if asked else ""


def offer(word: str, known: Iterable[str]) -> str:
    """Return a cure that names the nearest of the known words and then all of them."""
    known = list(known)
    return f"{ask_if_meant(find_nearest(word, known))} choose one of {', '.join(known)}".strip()
