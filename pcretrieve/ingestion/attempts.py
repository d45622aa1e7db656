"""One attempt at a scan in a worker process; if it fails: the next attempt, and what is changed for it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from pcretrieve.catalogue import Content, Record
from pcretrieve.errors import (
    InputError,
    MemoryExceeded,
    PcretrieveError,
    ScanReadError,
    StageTimeout,
    UnexpectedError,
    WorkerDied,
)
from pcretrieve.formats import ScanPath
from pcretrieve.options import PipelineOptions, SurfaceOptions
from pcretrieve.values import Step

Changes = dict[str, Any]  # of options of the table `surface`

# The edge of voxels with which a scan is tried again, in place of ``auto``: that of the second, coarser
# surface of noisy scans.
COARSE_CELL = 0.006

# Errors that may have been caused by the computer, or by earlier scans of the process, not by the scan alone.
PERHAPS_OF_THE_PROCESS = (
    StageTimeout,
    WorkerDied,
    MemoryExceeded,
    UnexpectedError,
    ScanReadError,
)


@dataclass(frozen=True, slots=True)
class Attempt:
    """A scan that is to be processed, and how its earlier attempts failed.

    n_taken: number of changes that were made, or left out, so far.
    """

    path: ScanPath
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


@dataclass(frozen=True, slots=True)
class Work:
    """What a worker does with attempts by some options: the content that the catalogue stores."""

    options: PipelineOptions

    def prepare(self) -> None:
        """Import what scans need: a worker without the memory for that does not start, and blames no scan."""
        from pcretrieve.arrays.open3d import library
        from pcretrieve.pipeline.process import compile_stages

        library()
        if self.options.surface.mode != "keep":
            compile_stages()

    def __call__(self, attempt: Attempt) -> Content:
        """Process the scan."""
        return content_of(attempt.path, self.options.changed(surface=attempt.changes))


def content_of(path: ScanPath, options: PipelineOptions) -> Content:
    """Process one scan."""
    from pcretrieve.pipeline.process import process, signature_of

    shape = process(path, options)
    signature = signature_of(shape, options, path).values
    mesh = shape.surfaces[0].mesh
    drawn = None if mesh is None else mesh.thumbnail()
    # Points and eigenvectors are not stored, and are not sent to the process that stores the content.
    surfaces = tuple(replace(surface, eigenpairs=None) for surface in shape.surfaces)
    stored = replace(shape, surfaces=surfaces, cloud=None)
    return Content(stored, signature, *(drawn or (None, None)))


def next_attempt(
    attempt: Attempt, error: PcretrieveError, options: PipelineOptions
) -> Attempt | None:
    """The next attempt at a scan that failed: in a new process, with cheaper settings, by the other method.

    A change that cannot help is left out: a new process if a stage has refused the scan, other settings if
    the scan cannot be read.
    """
    if isinstance(error, InputError):
        return None
    given = options.surface
    changes: list[Changes | None] = [
        {} if isinstance(error, PERHAPS_OF_THE_PROCESS) else None
    ]
    # In the mode ``keep``, no surface is reconstructed.
    if not isinstance(error, ScanReadError) and given.mode != "keep":
        changes += [
            _cheaper(given),
            {"method": "growth" if given.method == "poisson" else "poisson"},
        ]
    for number, change in list(enumerate(changes, 1))[attempt.n_taken :]:
        if change is not None:
            words = [
                f"with surface.{name} = {value} instead of {getattr(given, name)}"
                for name, value in change.items()
                if getattr(given, name) != value
            ]
            tried = ", ".join(words) or "in a new process"
            note = f"{type(error).__name__} ({error.stage}): {error.message}; tried again {tried}"
            return replace(
                attempt, changes=change, n_taken=number, notes=(*attempt.notes, note)
            )
    return None


def _cheaper(given: SurfaceOptions) -> Changes | None:
    """One surface, with larger voxels; None if the options are so already."""
    cell = COARSE_CELL if given.cell == "auto" else max(COARSE_CELL, given.cell)
    if given.method != "growth" or (given.reconstructions, given.cell) == (1, cell):
        return None
    return {"reconstructions": 1, "cell": cell}
