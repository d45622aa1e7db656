"""Defects that a check of a catalogue finds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

__all__ = ["Defect"]


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
