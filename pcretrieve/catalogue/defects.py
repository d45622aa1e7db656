"""Defects that a check of a catalogue finds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from pcretrieve.errors import CatalogueError

__all__ = ["ChangedRow", "Defect"]


@dataclass(frozen=True, slots=True)
class Defect:
    """Something that is wrong in a catalogue.

    Attributes
    ----------
    kind : {"database", "orphan", "shape", "signature", "index"}
        ``database``: a defect of the file or of its SQL indexes; ``orphan``: rows of no shape; ``shape``: a
        record or arrays that cannot be read, or that contradict each other; ``signature``: one that differs
        from what its surfaces give; ``index``: a stored index of nearest neighbours that cannot be read.
    shape_id : str or None
        Id of the shape.
    message : str
        What is wrong.
    repair : str or None
        What was done about it; None if nothing was done.
    """

    kind: Literal["database", "orphan", "shape", "signature", "index"]
    shape_id: str | None
    message: str
    repair: str | None = None


class ChangedRow(CatalogueError):
    """Texts or numbers of a row that are not those that were stored, as by a flipped bit on the disk.

    Parameters
    ----------
    location : str
        The catalogue, as the message names it.
    row : mapping of str to value
        The row as it is now, with `id`, `path` and `label`.
    parts : tuple of str
        What has changed: "id", "path", "label" or "record", which is everything else.

    Attributes
    ----------
    parts : tuple of str
        What has changed.
    fault : str
        The same in words.
    """

    def __init__(self, location: str, row: Mapping[str, object], parts: tuple[str, ...]) -> None:
        self.parts = parts
        named = [f"{name} {row[name]!r}" if name in row else name for name in parts]
        have = "has" if len(parts) == 1 else "have"
        self.fault = f"its {' and its '.join(named)} {have} changed since it was stored"
        super().__init__(
            f"{location} is damaged (shape {row['id']!r}: {self.fault}): restore a copy, or repair it with "
            "`pcretrieve check --repair`"
        )
