"""The exceptions of pcretrieve, as one tree.

    PcretrieveError                 .stage .shape_id
    ├─ InputError (ValueError)      an invalid request: a batch stops
    │  ├─ OptionError
    │  └─ BenchmarkError
    ├─ ShapeError                   one shape cannot be processed: a batch records it and goes on
    │  ├─ ScanReadError  ReconstructionError  RemeshError  DegenerateMeshError  SpectrumError
    │  └─ StageTimeout  WorkerDied  MemoryExceeded  UnexpectedError
    └─ CatalogueError               other options, newer schema, locked, corrupt

The function that fails raises an exception with the cause; `in_stage` adds the stage, and the pipeline the
identifier of the shape. `str(error)` is then, for example, ``[T17 / remesh] no closed surface``.
"""

from __future__ import annotations

import re
import traceback
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from enum import Enum
from pathlib import Path

# The folder of the sources of pcretrieve. Messages name the last line of a traceback that is in this folder.
PACKAGE = str(Path(__file__).parent)


class Stage(str, Enum):
    """The stages of pcretrieve from a file to a stored shape. Other packages add stages of other names."""

    READ = "read"
    MERGE = "merge"
    CROP = "crop"
    CLEAN = "clean"
    ORIENT = "orient"
    SURFACE = "surface"
    REMESH = "remesh"
    TOPOLOGY = "topology"
    SPECTRUM = "spectrum"
    SIGNATURE = "signature"
    WORKER = "worker"  # the worker process ended, in an unknown stage

    def __str__(self) -> str:
        return self.value


class PcretrieveError(Exception):
    """Base class of all exceptions that pcretrieve raises deliberately.

    Attributes
    ----------
    message : str
        What must hold, what was given, what to do.
    stage : str or None
        The stage that failed: a `Stage`, or the name of a stage that another package adds.
    shape_id : str or None
        Identifier of the shape that was being processed.
    """

    default_stage: Stage | None = None

    def __init__(
        self, message: str, *, stage: str | None = None, shape_id: str | None = None
    ) -> None:
        super().__init__(message)
        self.message = message
        self.stage: str | None = stage or self.default_stage
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

    default_stage = Stage.READ


class ReconstructionError(ShapeError):
    """No surface can be reconstructed from the points."""

    default_stage = Stage.SURFACE


class RemeshError(ShapeError):
    """The remesher returned no usable surface."""

    default_stage = Stage.REMESH


class DegenerateMeshError(ShapeError):
    """The surface is such that its spectrum cannot be computed."""

    default_stage = Stage.TOPOLOGY


class SpectrumError(ShapeError):
    """The eigenvalue problem has no usable solution."""

    default_stage = Stage.SPECTRUM


class StageTimeout(ShapeError):
    """The processing of a shape exceeded its time limit."""

    default_stage = Stage.WORKER


class WorkerDied(ShapeError):
    """The worker process of a shape ended without a result."""

    default_stage = Stage.WORKER


class MemoryExceeded(ShapeError):
    """The processing of a shape exceeded its memory limit."""


class UnexpectedError(ShapeError):
    """The processing of a shape raised an exception that pcretrieve does not handle."""


class CatalogueError(PcretrieveError):
    """The catalogue cannot be opened, read or written as requested."""


@contextmanager
def in_stage(stage: str) -> Iterator[None]:
    """Add the stage to the exceptions that are raised inside, and replace those of other libraries."""
    try:
        yield
    except PcretrieveError as error:
        if type(error) is InputError and stage != Stage.READ:
            # The arguments have been checked before: the shape has led to values that are not valid.
            raise ShapeError(error.message, stage=stage) from error
        error.stage = error.stage or stage
        raise
    except Exception as error:
        converted = shape_error(error, stage)
        raise converted from error
    except BaseException as error:
        # SystemExit and KeyboardInterrupt of a plug-in do not end a worker process, which records the stage.
        vars(error).setdefault("stage", stage)
        raise


def shape_error(error: BaseException, stage: str | None = None) -> PcretrieveError:
    """Convert any exception to one of this module, which can be pickled and unpickled in another process."""
    own = getattr(error, "stage", None)
    # In an exception of another library, the attribute may mean something else, unless `in_stage` has set it.
    kind = str if isinstance(error, PcretrieveError) else Stage
    stage = own if isinstance(own, kind) else stage
    if isinstance(error, PcretrieveError):
        base = next(base for base in type(error).__mro__ if base.__module__ == __name__)
        return error if base is type(error) else base(error.message, stage=stage)
    # Without memory for the stack of a thread, C++ says that a resource is "temporarily unavailable".
    if isinstance(error, MemoryError) or "Resource temporarily unavailable" in _words(
        error
    ):
        return MemoryExceeded(
            "the scan needs more memory than there is, or than --memory allows: raise that, or thin the scan",
            stage=stage,
        )
    frames = [
        frame
        for frame in traceback.extract_tb(error.__traceback__)
        if PACKAGE in frame.filename
    ]
    place = (
        f" (at {Path(frames[-1].filename).name}, line {frames[-1].lineno})"
        if frames
        else ""
    )
    return UnexpectedError(
        f"{type(error).__name__}: {_words(error)}{place}; this is a fault of pcretrieve, or of a package "
        "that it uses: please report it with the file that `pcretrieve lab report-problem` writes",
        stage=stage,
    )


def _words(error: BaseException) -> str:
    """The message of an exception of any class, whose own method may fail."""
    try:
        return str(error)
    except Exception:  # noqa: BLE001
        return "an exception without words"


# Zeros in front of a number, not those in it.
LEADING_ZEROS = re.compile(r"(?<!\d)0+(?=\d)")

# Smallest share of common characters of a name that is suggested (the ratio of difflib): that of three
# letters, two of which have changed places. Names with one or two mistakes in typing have more.
SIMILARITY = 0.66


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """The question whether another name was meant; case and leading zeros of numbers do not count."""
    names = {_folded(other): other for other in known}
    close = get_close_matches(_folded(name), names, n=1, cutoff=SIMILARITY)
    return f"; did you mean {names[close[0]]!r}?" if close else ""


def _folded(name: str) -> str:
    return LEADING_ZEROS.sub("", name.casefold())
