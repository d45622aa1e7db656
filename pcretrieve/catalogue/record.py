"""What a catalogue knows of one shape."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from datetime import datetime, timezone
from pathlib import Path

from pcretrieve.types import FloatArray, Shape, Step

__all__ = ["Content", "Record", "completed", "free_id", "numbered_id"]


@dataclass(frozen=True, slots=True, eq=False)
class Content:
    """What processing made of a scan.

    Attributes
    ----------
    shape : Shape
        Each of its surfaces with its mesh and its spectrum.
    signature : (L,) float64
        The values by the options of the catalogue.
    """

    shape: Shape
    signature: FloatArray


@dataclass(frozen=True, slots=True)
class Record:
    """One shape's provenance: everything but its arrays.

    Attributes
    ----------
    id : str
        Distinct within a catalogue: the file's name without its suffix, numbered where that is taken.
    path : str
        Absolute path of the file as it was read.
    content_hash : str
        SHA-256 of the file; of a ``.conf``, of the file and all its views.
    label : str or None
        The shape's class.
    status : {"done", "failed"}
    stage, error, message : str or None
        Where, how and why it failed.
    steps : tuple of Step
        What each stage did, repaired and fell back from, and how long it took.
    area : float or None
        Unit length² of the file.
    n_vertices, n_faces, euler : int or None
        Of the clean mesh.
    options_digest : str
        Of the options that made it.
    versions : dict of str to str
        Of pcretrieve and the libraries that move numbers.
    added : str
        UTC, ISO 8601.
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

    @property
    def seconds(self) -> float:
        """Time that all stages took together."""
        return sum(step.seconds for step in self.steps)


def completed(record: Record, content: Content | None, options_digest: str) -> Record:
    """A record that is stored now, with the sizes of its content.

    Parameters
    ----------
    record : Record
        The record of the file.
    content : Content or None
        None for a shape that failed.
    options_digest : str
        Of the options of the catalogue.

    Returns
    -------
    Record
        With the time of now, the digest and the sizes.
    """
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
    )


def numbered_id(stem: str, number: int) -> str:
    """The id of one of several files of the same name: ``cat``, ``cat-2``, ``cat-3``.

    Parameters
    ----------
    stem : str
        The name of the file without its suffix.
    number : int
        From 1.

    Returns
    -------
    str
        For the number 1, the stem itself.
    """
    return stem if number == 1 else f"{stem}-{number}"


def free_id(record: Record, is_taken: Callable[[str], bool]) -> str:
    """The record's id, or its file's name with a number where another path has that id.

    The number is doubled until it is free and then bisected, because one name may have many numbers.

    Parameters
    ----------
    record : Record
        A record whose path the store does not hold.
    is_taken : function of str that returns bool
        Whether another path has an id.

    Returns
    -------
    str
        An id that is not taken.
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
