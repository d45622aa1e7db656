"""The work of a worker process: one scan → what the catalogue stores of it."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from pcretrieve.catalogue import Content
from pcretrieve.descriptors import describe
from pcretrieve.draw import thumbnail
from pcretrieve.errors import DegenerateMeshError, Stage, in_stage
from pcretrieve.options import PipelineOptions
from pcretrieve.pipeline.process import process

__all__ = ["content"]


def content(path: Path, options: PipelineOptions) -> Content:
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
