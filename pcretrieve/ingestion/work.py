"""What one worker process does for one shape."""

from __future__ import annotations

import os
import signal
from dataclasses import replace
from functools import cache
from importlib.metadata import version
from pathlib import Path

from pcretrieve.catalogue import Content
from pcretrieve.descriptors import describe
from pcretrieve.errors import Stage, in_stage
from pcretrieve.options import PipelineOptions
from pcretrieve.pipeline.process import process

__all__ = ["content", "prepare", "versions"]

GIB = 1 << 30


def prepare(memory: float | None) -> None:
    """Make this process a worker: one thread, a limit to its memory (GiB), deaf to Ctrl-C, silent.

    What a reader or native code prints goes to standard error: standard output is the command's.
    """
    from threadpoolctl import threadpool_limits

    os.dup2(2, 1)
    # The terminal sends Ctrl-C to every process; the one that holds the catalogue decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threadpool_limits(limits=1)
    if memory is not None:
        import resource

        limit = int(memory * GIB)
        resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))


def content(path: Path, options: PipelineOptions) -> Content:
    """Everything that a catalogue stores of one scan."""
    shape = process(path, options)
    with in_stage(Stage.SIGNATURE):
        signature = describe(shape, options.signature).values
    # The points are not stored, and need not be sent to the process that stores the rest.
    return Content(replace(shape, cloud=None), signature)


@cache
def versions() -> dict[str, str]:
    """Versions of everything that moves numbers."""
    return {name: version(name) for name in ("pcretrieve", "open3d", "pytetwild", "numpy", "scipy")}
