"""What one worker process does for one shape."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from importlib.metadata import version
from pathlib import Path

from pcretrieve import __version__
from pcretrieve.catalogue import Content
from pcretrieve.descriptors import describe
from pcretrieve.errors import Stage, in_stage
from pcretrieve.options import PipelineOptions
from pcretrieve.pipeline.process import process

__all__ = ["content", "versions"]


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
    # In a source folder on the path, pcretrieve has no metadata, or those of another version.
    others = ("open3d", "pytetwild", "numpy", "scipy")
    return {"pcretrieve": __version__} | {name: version(name) for name in others}
