"""The questions of a request: what is listed, and what is searched; from the fields of its address."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from urllib.parse import urlencode

from pcretrieve.errors import InputError, OptionError

__all__ = ["PAGE", "SORTS", "STATES", "Busy", "Listing", "NotFound", "Similar", "TooLarge", "TooSlow"]

#: Number of shapes on a page of the collection.
PAGE = 60

# Largest number of results of one query, so that a request cannot ask for a catalogue with all provenance.
MOST_RESULTS = 1000

SORTS = ("id", "-id", "label", "-label", "added", "-added")
STATES = ("", "done", "doubtful", "failed")


class NotFound(InputError):
    """There is nothing of this name."""


class TooLarge(InputError):
    """The body of a request has too many bytes."""


class TooSlow(InputError):
    """The body of a request has not arrived in time."""


class Busy(InputError):
    """Too many requests of this kind wait."""


@dataclass(frozen=True, slots=True)
class Listing:
    """Which shapes are listed, and in which order.

    sort: the order; ``-`` for descending.
    """

    words: str = ""
    label: str = ""
    state: str = ""
    sort: str = "id"
    since: str = ""
    until: str = ""
    page: int = 1

    @classmethod
    def of(cls, fields: Mapping[str, str]) -> Listing:
        """Read the fields ``q label state sort since until page`` of an address."""
        state, sort = fields.get("state", ""), fields.get("sort") or "id"
        if state not in STATES:
            raise OptionError(f"state must be one of {', '.join(STATES[1:])}, or empty, got {state!r}")
        if sort not in SORTS:
            raise OptionError(f"sort must be one of {', '.join(SORTS)}, got {sort!r}")
        since, until = _day(fields, "since"), _day(fields, "until")
        page = _whole(fields, "page", 1, 1, 10**9)
        return cls(fields.get("q", ""), fields.get("label", ""), state, sort, since, until, page)

    def address(self, page: int) -> str:
        """The fields of another page of the same listing, as the end of an address."""
        fields = {"q": self.words, "label": self.label, "state": self.state, "sort": self.sort}
        fields |= {"since": self.since, "until": self.until}
        chosen = {name: value for name, value in fields.items() if value and (name, value) != ("sort", "id")}
        return "?" + urlencode(chosen | ({"page": str(page)} if page > 1 else {}))


@dataclass(frozen=True, slots=True)
class Similar:
    """What is asked of the neighbours of a shape."""

    k: int = 12
    label: str = ""
    min_score: float | None = None

    @classmethod
    def of(cls, fields: Mapping[str, str]) -> Similar:
        """Read the fields ``k label min_score`` of an address."""
        least = fields.get("min_score", "").strip()
        try:
            min_score = float(least) if least else None
        except ValueError:
            raise OptionError(f"min_score must be a number from 0 to 1, got {least!r}") from None
        if min_score is not None and not 0 <= min_score <= 1:
            raise OptionError(f"min_score must be a number from 0 to 1, got {least!r}")
        return cls(_whole(fields, "k", 12, 1, MOST_RESULTS), fields.get("label", ""), min_score)

    def address(self) -> str:
        """The fields, as the end of an address; empty if they are the defaults."""
        fields = {"k": str(self.k)} if self.k != 12 else {}
        fields |= {"label": self.label} if self.label else {}
        fields |= {"min_score": f"{self.min_score:g}"} if self.min_score is not None else {}
        return f"?{urlencode(fields)}" if fields else ""


def _day(fields: Mapping[str, str], name: str) -> str:
    text = fields.get(name, "").strip()
    try:
        return text and date.fromisoformat(text).isoformat()
    except ValueError:
        raise OptionError(f"{name} must be a day such as 2026-01-31, got {text[:20]!r}") from None


def _whole(fields: Mapping[str, str], name: str, default: int, least: int, most: int) -> int:
    text = fields.get(name, "").strip()
    if not text:
        return default
    # Not `int`, which takes underscores, and digits of any length for a long time.
    if not (text.isascii() and text.isdigit() and len(text) < 12 and least <= int(text) <= most):
        raise OptionError(f"{name} must be a whole number from {least} to {most}, got {text[:20]!r}")
    return int(text)
