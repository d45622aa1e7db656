"""The record of a shape in a catalogue, and the content that is stored of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from datetime import datetime, timezone
from pathlib import Path

from pcretrieve.values import UNIT, FloatArray, Shape, Step, Verdict

__all__ = ["Content", "Record", "completed", "free_id", "numbered_id"]


@dataclass(frozen=True, slots=True, eq=False)
class Content:
    """The result of processing a scan.

    signature: (L,) float64, values of the signature by the options of the catalogue.
    """

    shape: Shape
    signature: FloatArray
    thumbnail: bytes | None = None


@dataclass(frozen=True, slots=True)
class Record:
    """The provenance of one shape: everything except its arrays.

    area: area of the first surface, in the square of the unit of the scan: see `metres_per_unit`.
    """

    id: str
    path: str
    content_hash: str
    label: str | None = None
    status: str = "done"
    stage: str | None = None
    error: str | None = None
    message: str | None = None
    steps: tuple[Step, ...] = ()
    area: float | None = None
    n_vertices: int | None = None
    n_faces: int | None = None
    euler: int | None = None
    options_digest: str = ""
    versions: dict[str, str] = field(default_factory=dict)
    added: str = ""
    verdict: Verdict | None = None
    stamp: str | None = None

    @property
    def is_doubtful(self) -> bool:
        """Whether the verdict is "doubtful" or "unusable"; false if the shape was not judged."""
        return self.verdict is not None and not self.verdict.is_sound

    @property
    def metres_per_unit(self) -> float | None:
        """Length of the unit of the area; metres. None if the format of the file does not have a unit."""
        return next((step.sizes[UNIT] for step in self.steps if UNIT in step.sizes), None)

    @property
    def seconds(self) -> float:
        """Total time of all stages; seconds."""
        return sum(step.seconds for step in self.steps)


def completed(record: Record, content: Content | None, options_digest: str) -> Record:
    """Complete a record before it is stored."""
    added = datetime.now(timezone.utc).isoformat(timespec="seconds")
    record = replace(record, options_digest=options_digest, added=added)
    if content is None:
        return record
    mesh = content.shape.mesh
    return replace(
        record,
        area=content.shape.area,
        n_vertices=len(mesh.vertices),
        n_faces=len(mesh.faces),
        euler=mesh.euler_characteristic,
        verdict=content.shape.verdict,
    )


def numbered_id(stem: str, number: int) -> str:
    """The id of one of several files of the same name: ``cat``, ``cat-2``, ``cat-3``."""
    return stem if number == 1 else f"{stem}-{number}"


def free_id(record: Record, is_taken: Callable[[str], bool]) -> str:
    """The id of a record, or the name of its file with a number if another path has this id.

    The number is doubled until it is free and then bisected, because one name may have many numbers.
    """
    if not is_taken(record.id):
        return record.id
    stem = Path(record.path).stem
    free = 1
    while is_taken(numbered_id(stem, free)):
        free *= 2
    taken = free // 2
    while free - taken > 1:
        middle = (free + taken) // 2
        if is_taken(numbered_id(stem, middle)):
            taken = middle
        else:
            free = middle
    return numbered_id(stem, free)
