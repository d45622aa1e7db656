"""Words for the message about an unknown name: which known name was meant."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

__all__ = ["did_you_mean"]

# Smallest share of common characters of a name that is suggested (the ratio of difflib). Names that differ by
# one or two mistakes in typing have more.
SIMILARITY = 0.7


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """The question whether another name was meant."""
    names = {other.casefold(): other for other in known}
    close = get_close_matches(name.casefold(), names, n=1, cutoff=SIMILARITY)
    return f"; did you mean {names[close[0]]!r}?" if close else ""
