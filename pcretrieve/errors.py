"""The exceptions of pcretrieve, as one tree.

    PcretrieveError                 .stage .shape_id
    ├─ InputError (ValueError)      an invalid request: a batch stops
    │  ├─ OptionError
    │  └─ BenchmarkError
    ├─ ShapeError                   one shape cannot be processed: a batch records it and goes on
    │  ├─ ScanReadError  ReconstructionError  RemeshError  DegenerateMeshError
    │  ├─ SpectrumError
    │  │  └─ ExtraZeroModes  NegativeEigenvalues  NonFiniteSpectrum  SpectrumNotConverged
    │  └─ StageTimeout  WorkerDied  MemoryExceeded  UnexpectedError
    └─ CatalogueError               other options, newer schema, locked, corrupt

The function that fails raises an exception with the cause; the pipeline adds the stage and the identifier of
the shape. `str(error)` is then, for example, ``[T17 / remesh] no closed surface``.
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
    """Base class of all exceptions that pcretrieve raises deliberately.

    Attributes
    ----------
    message : str
        What must hold, what was given, what to do.
    stage : str or None
        The stage that failed: ``read``, ``merge``, ``clean``, ``orient``, ``surface``, ``remesh``,
        ``topology``, ``spectrum`` or ``signature``; ``worker`` if the worker process ended.
    shape_id : str or None
        Identifier of the shape that was being processed.
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
    """The arguments of a call are invalid."""


class OptionError(InputError):
    """An option does not exist, or its value is invalid."""


class BenchmarkError(InputError):
    """The labels of a data set do not match its shapes, or are too few for the evaluation."""


class ShapeError(PcretrieveError):
    """One shape cannot be processed; other shapes are not affected."""


class ScanReadError(ShapeError):
    """A file cannot be read as a scan."""

    default_stage = "read"


class ReconstructionError(ShapeError):
    """No surface can be reconstructed from the points."""

    default_stage = "surface"


class RemeshError(ShapeError):
    """The remesher returned no usable surface."""

    default_stage = "remesh"


class DegenerateMeshError(ShapeError):
    """The surface is such that its spectrum cannot be computed."""

    default_stage = "topology"


class SpectrumError(ShapeError):
    """The eigenvalue problem has no usable solution."""

    default_stage = "spectrum"


class ExtraZeroModes(SpectrumError):
    """The operator has more than the one zero eigenvalue of a connected surface."""


class NegativeEigenvalues(SpectrumError):
    """The operator is not positive semi-definite."""


class NonFiniteSpectrum(SpectrumError):
    """The eigenvalue solver returned NaN or infinite numbers."""


class SpectrumNotConverged(SpectrumError):
    """The eigenvalue solver stopped before its residuals were below the tolerance."""


class StageTimeout(ShapeError):
    """The processing of a shape exceeded its time limit."""

    default_stage = "worker"


class WorkerDied(ShapeError):
    """The worker process of a shape ended without a result."""

    default_stage = "worker"


class MemoryExceeded(ShapeError):
    """The processing of a shape exceeded its memory limit."""


class UnexpectedError(ShapeError):
    """The processing of a shape raised an exception that pcretrieve does not handle."""


class CatalogueError(PcretrieveError):
    """The catalogue cannot be opened, read or written as requested."""
