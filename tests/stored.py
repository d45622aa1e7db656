"""All that a catalogue has, so that tests can compare two of them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from pcretrieve import Catalogue

Everything = dict[str, tuple[Any, ...]]


def everything(location: str) -> Everything:
    """The row, the signatures and the payloads of each shape, without times."""
    with Catalogue(location) as store:
        found = {}
        for entry in store.entries([origin.id for origin in store.origins()]):
            steps = tuple(replace(step, seconds=0.0) for step in entry.record.steps)
            record = replace(entry.record, steps=steps, added="", stamp=None)
            found[record.id] = (record, dict(entry.signatures), dict(entry.payloads))
        return found
