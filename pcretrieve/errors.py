"""What can go wrong, as one tree.

    PcretrieveError                 .stage .shape_id
    ├─ InputError (ValueError)      the caller's fault: stop
    │  ├─ OptionError
    │  └─ BenchmarkError
    ├─ ShapeError                   this shape's fault: record it, go on
    │  ├─ ScanReadError  ReconstructionError  RemeshError  DegenerateMeshError
    │  ├─ SpectrumError
    │  │  └─ ExtraZeroModes  NegativeEigenvalues  NonFiniteSpectrum  SpectrumNotConverged
    │  └─ StageTimeout  WorkerDied  MemoryExceeded  UnexpectedError
    └─ CatalogueError               other options, newer schema, locked, corrupt

A stage raises with the cause; whoever knows the shape and the stage adds the place. `str(error)` then
reads ``[T17 / remesh] no closed surface``.
"""

from __future__ import annotations

__all__ = [
    "BenchmarkError",
    "CatalogueError",
    "DegenerateMeshError",
    "ExtraZeroModes",
    "InputError",
    "MemoryExceeded",
    "NegativeEigenvalues",
    "NonFiniteSpectrum",
    "OptionError",
    "PcretrieveError",
    "ReconstructionError",
    "RemeshError",
    "ScanReadError",
    "ShapeError",
    "SpectrumError",
    "SpectrumNotConverged",
    "StageTimeout",
    "UnexpectedError",
    "WorkerDied",
]


class PcretrieveError(Exception):
    """Base of every error that pcretrieve raises on purpose.

    Attributes
    ----------
    message : str
        What must hold, what was given, what to do.
    stage : str or None
        The stage it happened in: ``read``, ``merge``, ``clean``, ``orient``, ``surface``, ``remesh``,
        ``topology``, ``spectrum``, ``signature``; or ``worker``, where the process that worked on it ended.
    shape_id : str or None
        The shape it happened to.
    """

    default_stage: str | None = None

    def __init__(self, message: str, *, stage: str | None = None, shape_id: str | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.stage = stage or self.default_stage
        self.shape_id = shape_id

    def __str__(self) -> str:
        place = " / ".join(part for part in (self.shape_id, self.stage) if part)
        return f"[{place}] {self.message}" if place else self.message


class InputError(PcretrieveError, ValueError):
    """The caller asked for something that cannot be done."""


class OptionError(InputError):
    """An option has a value that it cannot have, or a name that does not exist."""


class BenchmarkError(InputError):
    """A labelled set does not fit its labels, or is too small for what was asked."""


class ShapeError(PcretrieveError):
    """One shape cannot be processed; the others can."""


class ScanReadError(ShapeError):
    """A file cannot be read as a scan."""

    default_stage = "read"


class ReconstructionError(ShapeError):
    """No surface can be made from these points."""

    default_stage = "surface"


class RemeshError(ShapeError):
    """The remesher gave nothing usable."""

    default_stage = "remesh"


class DegenerateMeshError(ShapeError):
    """A surface is not one that a spectrum can be computed on."""

    default_stage = "topology"


class SpectrumError(ShapeError):
    """The eigenvalue problem has no usable answer."""

    default_stage = "spectrum"


class ExtraZeroModes(SpectrumError):
    """More eigenvalues are zero than the one of a connected surface."""


class NegativeEigenvalues(SpectrumError):
    """The operator is not positive semi-definite."""


class NonFiniteSpectrum(SpectrumError):
    """The solver gave NaN or infinite numbers."""


class SpectrumNotConverged(SpectrumError):
    """The solver stopped before its residuals fell below the tolerance."""


class StageTimeout(ShapeError):
    """A shape took longer than it was given."""

    default_stage = "worker"


class WorkerDied(ShapeError):
    """The process that worked on a shape ended without an answer."""

    default_stage = "worker"


class MemoryExceeded(ShapeError):
    """A shape needed more memory than it was given."""


class UnexpectedError(ShapeError):
    """A shape met a fault in pcretrieve, or in a library under it, that nobody has thought of."""


class CatalogueError(PcretrieveError):
    """The catalogue file cannot be used as asked."""
