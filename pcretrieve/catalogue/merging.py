"""Several stores → one store, with every shape as its part has it."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

from pcretrieve.catalogue.rows import Entry, Origin, Rows
from pcretrieve.errors import CatalogueError

__all__ = ["Merged", "merge_rows"]

logger = logging.getLogger(__name__)

# Number of shapes that are stored in one transaction.
STORED_AT_ONCE = 500

# Number of conflicts that a message names.
NAMED = 5


@dataclass(frozen=True, slots=True)
class Merged:
    """The result of a merge."""

    n_added: int
    n_held: int


def merge_rows(target: Rows, parts: Sequence[Rows]) -> Merged:
    """Store in one store the shapes of others.

    Of a path that several stores have, the first finished shape is kept, or the first failure if none is
    finished, with the label that one of them has. The merge is associative: parts can be merged in groups,
    and the merged groups again. After an interruption the same call continues.
    """
    stores = [target, *parts]
    chosen: dict[str, tuple[int, Origin]] = {}  # by path: the number of the store, and the row in it
    labels: dict[str, str] = {}
    conflicts: list[str] = []
    for number, store in enumerate(stores):
        for origin in store.origins():
            path = origin.path
            earlier, other = chosen.setdefault(path, (number, origin))
            places = f"in {stores[earlier].location} and in {store.location}"
            if origin.label != labels.setdefault(path, origin.label or "") and origin.label:
                if labels[path]:
                    conflicts.append(f"{path} has the labels {labels[path]!r} and {origin.label!r} {places}")
                labels[path] = origin.label
            if {origin.status, other.status} == {"done"} and origin.content_hash != other.content_hash:
                conflicts.append(f"{path} has different contents {places}")
            if origin.status == "done" and other.status == "failed":
                chosen[path] = number, origin
    paths: dict[str, str] = {}
    for path, (number, origin) in chosen.items():
        if (other_path := paths.setdefault(origin.id, path)) != path:
            before = stores[chosen[other_path][0]].location
            here = stores[number].location
            conflicts.append(f"{origin.id!r} is {other_path} in {before} and {path} in {here}")
    if conflicts:
        more = f"; and {len(conflicts) - NAMED} more" if len(conflicts) > NAMED else ""
        raise CatalogueError(
            f"catalogues with conflicts cannot be merged: {'; '.join(conflicts[:NAMED])}{more}. Remove the "
            "shape from one of both (pcretrieve remove), or ingest its file again"
        )
    added: dict[int, list[str]] = {number: [] for number in range(len(stores))}  # ids by store
    for number, origin in chosen.values():
        added[number].append(origin.id)
    n_held = len(added.pop(0))
    n_added, n_stored = sum(map(len, added.values())), 0
    for number, ids in added.items():
        for start in range(0, len(ids), STORED_AT_ONCE):
            entries = stores[number].entries(ids[start : start + STORED_AT_ONCE])
            target.add([_labelled(entry, labels[entry.record.path] or None) for entry in entries])
            n_stored += len(entries)
            logger.info("stored: %d of %d shapes", n_stored, n_added)
    held = {path: origin for path, (place, origin) in chosen.items() if place == 0}
    new_labels = {path: labels[path] for path, origin in held.items() if labels[path] != (origin.label or "")}
    if new_labels:
        target.revise(moved={}, removed=(), labels=new_labels, stamps={})
    return Merged(n_added, n_held)


def _labelled(entry: Entry, label: str | None) -> Entry:
    if entry.record.label == label:
        return entry
    return replace(entry, record=replace(entry.record, label=label))
