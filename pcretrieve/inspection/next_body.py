"""How far the next body is: by a catalogue, or as it is among people."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pcretrieve.catalogue import Catalogue
from pcretrieve.checks import NEXT_BODY
from pcretrieve.errors import InputError
from pcretrieve.ingestion.discover import content_hash
from pcretrieve.options import PipelineOptions
from pcretrieve.values import Signature

__all__ = ["NextBody", "next_body_in", "ratio_words"]

# Parts in words, and the smallest ratio of each, midway to the part before.
PARTS = (
    (0.0, "less than a twentieth of"),
    (0.045, "a twentieth of"),
    (0.075, "a tenth of"),
    (0.125, "a seventh of"),
    (0.17, "a fifth of"),
    (0.225, "a quarter of"),
    (0.29, "a third of"),
    (0.365, "two fifths of"),
    (0.45, "half of"),
    (0.58, "two thirds of"),
    (0.71, "three quarters of"),
    (0.87, "as large as"),
)
LARGEST_PART = 1.15


@dataclass(frozen=True, slots=True)
class NextBody:
    """The most similar other body."""

    distance: float = NEXT_BODY
    id: str | None = None
    label: str | None = None
    source: str = (
        f"The distance to the next body, {NEXT_BODY:g}, is that of people: simulated ones are "
        "that far from the most similar other person. Name a catalogue to have it measured there."
    )


def ratio_words(ratio: float) -> str:
    """A ratio in words that stand before "the distance", such as "a third of" and "2.5 times"."""
    if ratio > LARGEST_PART:
        return f"{ratio:.2g} times" if ratio < 100 else "more than 100 times"
    return PARTS[bisect_right([least for least, _ in PARTS], ratio) - 1][1]


def next_body_in(
    catalogue: Catalogue, signature: Signature, options: PipelineOptions, *, path: Path | None = None
) -> NextBody:
    """Find the shape of a catalogue that is nearest to a scan and of another body.

    The class of the scan is its class in the catalogue, if the catalogue has it, or else that of the nearest
    shape. The next body is the nearest shape of another class; if the classes are not known, the nearest
    shape.
    """
    plain = options.changed(retrieval={"distance": "log", "whitening": "none", "calibration": None})
    table = catalogue.signatures(plain)
    if table.metric != "logarithms":
        raise InputError(
            f"error bars are those of logarithms, as which {table.kind} is not compared: leave out the "
            "catalogue"
        )
    own = catalogue.with_content(content_hash(path)) if path is not None else []
    held = {record.id for record in own}
    gaps = np.linalg.norm(np.log(table.values) - np.log(signature.values), axis=1)  # (N,)
    others = [row for row in np.argsort(gaps, kind="stable").tolist() if table.ids[row] not in held]
    own_labels = [record.label for record in own if record.label is not None]
    label = own_labels[0] if own_labels else table.labels[others[0]] if others else None
    rows = [row for row in others if label is None or table.labels[row] not in (None, label)]
    if not rows:
        return NextBody(source=f"The catalogue has no other body: {NEXT_BODY:g} is the distance of people.")
    row, nearest = rows[0], others[0]
    names = [
        shape_id if known is None else f"{shape_id} (class {known})"
        for shape_id, known in zip(table.ids, table.labels, strict=True)
    ]
    words = f"The next body in the catalogue is {names[row]}, {gaps[row]:.2g} away"
    if nearest != row:
        words += f"; the nearest shape is {names[nearest]}, {gaps[nearest]:.2g} away"
    if label is None:
        words += "; as its class is not known, it may be the same body"
    return NextBody(float(gaps[row]), table.ids[row], table.labels[row], f"{words}.")
