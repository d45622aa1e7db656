"""One attempt at a scan in a worker process; if it fails: the next attempt, and what is changed for it."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pcretrieve.catalogue import Content, Record
from pcretrieve.descriptors import describe
from pcretrieve.draw import thumbnail
from pcretrieve.errors import (
    DegenerateMeshError,
    InputError,
    MemoryExceeded,
    PcretrieveError,
    ScanReadError,
    Stage,
    StageTimeout,
    UnexpectedError,
    WorkerDied,
    in_stage,
)
from pcretrieve.options import PipelineOptions
from pcretrieve.pipeline.process import process
from pcretrieve.values import Step

Changes = dict[str, dict[str, Any]]

# The edge of voxels with which a scan is tried again, in place of ``auto``: that of the second, coarser
#: surface of noisy scans.
COARSE_CELL = 0.006

# Errors that may have been caused by the computer, or by earlier scans of the process, not by the scan alone.
PERHAPS_OF_THE_PROCESS = (StageTimeout, WorkerDied, MemoryExceeded, UnexpectedError, ScanReadError)


@dataclass(frozen=True, slots=True)
class Attempt:
    """A scan that is to be processed, and how its earlier attempts failed."""

    path: Path
    record: Record
    changes: Changes = field(default_factory=dict)
    n_taken: int = 0
    notes: tuple[str, ...] = ()

    @property
    def steps(self) -> tuple[Step, ...]:
        """The step ``retry`` of the provenance; none for a first attempt."""
        if not self.notes:
            return ()
        return (Step("retry", 0.0, {"attempts": len(self.notes) + 1}, self.notes),)


def work_on(options: PipelineOptions, attempt: Attempt) -> Content:
    """What the catalogue stores of one scan."""
    return content_of(attempt.path, options.changed(**attempt.changes))


def content_of(path: Path, options: PipelineOptions) -> Content:
    """Process one scan."""
    shape = process(path, options)
    with in_stage(Stage.SIGNATURE):
        signature = describe(shape, options.signature).values
    picture = None
    if "meshes" in options.catalogue.keep and shape.surfaces[0].mesh is not None:
        with suppress(DegenerateMeshError):
            picture = thumbnail(shape.mesh.vertices, shape.mesh.faces, up=shape.mesh.up)
    # Points and eigenvectors are not stored, and are not sent to the process that stores the content.
    surfaces = tuple(replace(surface, eigenpairs=None) for surface in shape.surfaces)
    return Content(replace(shape, surfaces=surfaces, cloud=None), signature, picture)


def next_attempt(attempt: Attempt, error: PcretrieveError, options: PipelineOptions) -> Attempt | None:
    """The next attempt at a scan that failed.

    Each attempt has one more of these changes: a process that is started after the failure; cheaper settings
    (one surface, with larger voxels, and no optimisation of the remesher); the other method of surface
    reconstruction, instead of cheaper settings. A change that cannot help is left out: a new process if a
    stage has refused the scan, other settings if the scan cannot be read.
    """
    if isinstance(error, InputError):
        return None
    for number, made in list(enumerate((_new_process, _cheaper, _fallback), 1))[attempt.n_taken :]:
        change = made(error, options)
        if change is not None:
            words = ", ".join(_words(change, options)) or "in a new process"
            note = f"{type(error).__name__} ({error.stage}): {error.message}; tried again {words}"
            return replace(attempt, changes=change, n_taken=number, notes=(*attempt.notes, note))
    return None


def _new_process(error: PcretrieveError, options: PipelineOptions) -> Changes | None:
    return {} if isinstance(error, PERHAPS_OF_THE_PROCESS) else None


def _cheaper(error: PcretrieveError, options: PipelineOptions) -> Changes | None:
    if isinstance(error, ScanReadError):
        return None
    change: Changes = {}
    if _reconstructs(options) and options.surface.method == "growth":
        cell = options.surface.cell
        coarse = COARSE_CELL if cell == "auto" else cell
        change["surface"] = {"reconstructions": 1, "cell": max(COARSE_CELL, coarse)}
    return {
        table: values
        for table, values in change.items()
        if any(getattr(getattr(options, table), name) != value for name, value in values.items())
    } or None


def _fallback(error: PcretrieveError, options: PipelineOptions) -> Changes | None:
    if isinstance(error, ScanReadError) or not _reconstructs(options):
        return None
    return {"surface": {"method": "growth" if options.surface.method == "poisson" else "poisson"}}


def _reconstructs(options: PipelineOptions) -> bool:
    """Whether surfaces are reconstructed, at least of scans that are no closed meshes."""
    return options.surface.mode != "keep"


def _words(change: Changes, options: PipelineOptions) -> list[str]:
    """Each changed option, its value, and that of the catalogue."""
    return [
        f"with {table}.{name} = {value} instead of {getattr(getattr(options, table), name)}"
        for table, values in change.items()
        for name, value in values.items()
        if getattr(getattr(options, table), name) != value
    ]
