"""Catalogue → the shapes that a page of the collection shows."""

from __future__ import annotations

from collections import defaultdict
from typing import NamedTuple

from pcretrieve.catalogue import Catalogue, Record
from pcretrieve.web.requests import PAGE, Listing

__all__ = ["Found", "class_names", "listed"]


# Length of the day in a time as catalogues store it, which is UTC: 2026-01-31T12:00:00+00:00.
DAY = 10
LAST = "9999-12-31"


class Found(NamedTuple):
    """The shapes of one page."""

    total: int
    records: list[Record]


def listed(catalogue: Catalogue, listing: Listing) -> Found:
    """Find the shapes of one page."""
    words = listing.words.casefold().split()
    among = None
    if listing.state == "doubtful":
        among = {record.id for page in catalogue.pages(doubtful=True) for record in page}
    chosen = [
        origin
        for origin in catalogue.origins()
        if (not listing.label or origin.label == listing.label)
        and (listing.state not in ("done", "failed") or origin.status == listing.state)
        and (among is None or origin.id in among)
        and all(word in origin.id.casefold() for word in words)
    ]
    if listing.since or listing.until or listing.sort.endswith("added"):
        times = defaultdict(str, catalogue.times())  # without shapes that were stored since
        last = listing.until or LAST
        chosen = [origin for origin in chosen if listing.since <= times[origin.id][:DAY] <= last]
    if listing.sort.endswith("label"):  # a stable sort, so that shapes of one class are in the order of ids
        chosen.sort(key=lambda origin: (origin.label is None, origin.label or ""))
    elif listing.sort.endswith("added"):
        chosen.sort(key=lambda origin: times[origin.id])
    if listing.sort.startswith("-"):
        chosen.reverse()
    start = (listing.page - 1) * PAGE
    ids = [origin.id for origin in chosen[start : start + PAGE]]
    found = (catalogue.get(shape_id) for shape_id in ids)
    return Found(len(chosen), [record for record in found if record is not None])


def class_names(catalogue: Catalogue) -> list[str]:
    """The classes of the shapes of a catalogue."""
    return sorted({origin.label for origin in catalogue.origins() if origin.label is not None})
