"""Defects that a check of a catalogue finds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from pcretrieve.errors import CatalogueError

__all__ = ["ChangedRow", "Defect"]


@dataclass(frozen=True, slots=True)
class Defect:
    """Something that is wrong in a catalogue."""

    kind: Literal["database", "orphan", "shape", "signature", "index"]
    shape_id: str | None
    message: str
    repair: str | None = None


class ChangedRow(CatalogueError):
    """Texts or numbers of a row that are not those that were stored, as by a flipped bit on the disk."""

    def __init__(self, location: str, row: Mapping[str, object], parts: tuple[str, ...]) -> None:
        self.parts = parts
        named = [f"{name} {row[name]!r}" if name in row else name for name in parts]
        have = "has" if len(parts) == 1 else "have"
        self.fault = f"its {' and its '.join(named)} {have} changed since it was stored"
        super().__init__(
            f"{location} is damaged (shape {row['id']!r}: {self.fault}): restore a copy, or repair it with "
            "`pcretrieve check --repair`"
        )
