"""What a catalogue knows of one shape."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from pcretrieve.types import FloatArray, ModalSpectrum, Step, TriangleMesh

if TYPE_CHECKING:
    from pcretrieve.catalogue.store import Catalogue

__all__ = ["Content", "Record", "StoredShape", "free_id", "numbered_id"]


@dataclass(frozen=True, slots=True, eq=False)
class Content:
    """What processing made of a scan.

    Attributes
    ----------
    mesh : TriangleMesh
        Unit length of the file.
    spectrum : ModalSpectrum
        Of the mesh scaled to unit area.
    signature : (L,) float64
    others : tuple of ModalSpectrum
        Of further surfaces made of the same scan.
    """

    mesh: TriangleMesh
    spectrum: ModalSpectrum
    signature: FloatArray
    others: tuple[ModalSpectrum, ...] = ()


@dataclass(frozen=True)
class StoredShape:
    """A shape as descriptors see it, read from its catalogue piece by piece as it is asked for.

    Attributes
    ----------
    spectrum : ModalSpectrum
        Of the mesh scaled to unit area.
    area : float
        Unit length² of the file.
    mesh : TriangleMesh
        Unit length of the file.
    others : tuple of ModalSpectrum
        Of further surfaces made of the same scan.
    """

    catalogue: Catalogue
    id: str

    @cached_property
    def _spectra(self) -> tuple[ModalSpectrum, ...]:
        return self.catalogue.spectra(self.id)

    @property
    def spectrum(self) -> ModalSpectrum:
        return self._spectra[0]

    @property
    def others(self) -> tuple[ModalSpectrum, ...]:
        return self._spectra[1:]

    @property
    def area(self) -> float:
        # A shape that failed has none, but its spectrum is refused before.
        return self.catalogue.record(self.id).area or 0.0

    @property
    def mesh(self) -> TriangleMesh:
        return self.catalogue.mesh(self.id)


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


def numbered_id(stem: str, number: int) -> str:
    """The id of the `number`-th file that is called `stem`: ``cat``, ``cat-2``, ``cat-3``."""
    return stem if number == 1 else f"{stem}-{number}"


def free_id(record: Record, is_taken: Callable[[str], bool]) -> str:
    """The record's id, or its file's name with a number where another path has that id.

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
