"""The formats 3MF and COLLADA (``.dae``), scenes of several bodies that trimesh reads."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

from pcretrieve.errors import ScanReadError
from pcretrieve.formats.files import check_archive
from pcretrieve.formats.format import Extra, Format
from pcretrieve.formats.members import Members, distinct_names
from pcretrieve.formats.raw import RawScan, incomplete, joined, merged_vertices
from pcretrieve.formats.trimesh import Body, scene_bodies
from pcretrieve.values import unit_of

__all__ = ["COLLADA", "THREE_MF"]

# Names of units in 3MF files.
UNITS = {
    "micron": "um",
    "millimeter": "mm",
    "centimeter": "cm",
    "meter": "m",
    "inch": "in",
    "foot": "ft",
    "millimeters": "mm",
    "meters": "m",  # by trimesh, where a file names none
}


class Scene(NamedTuple):
    """The bodies of a file, in its own unit or in parts of it.

    unit: the unit of the scan, a key of `METRES`; None if the file does not say.
    scale: the unit of the bodies, in units of the scan.
    """

    bodies: Sequence[Body]
    unit: str | None
    scale: float = 1.0


ReadScene = Callable[[Path], Scene]


def _format(suffix: str, extra: Extra, read_scene: ReadScene) -> Format:
    """The format of a suffix. The readers raise ScanReadError if a file is damaged, or holds no triangles."""
    return Format(
        (suffix,),
        partial(_read, read_scene),
        members=Members(partial(_names, read_scene), partial(_read, read_scene)),
        extra=extra,
    )


def _read(read_scene: ReadScene, path: Path, name: str | None = None) -> RawScan:
    """All bodies of the scene as one scan, or the body of a name."""
    bodies, unit, scale = _scene(read_scene, path)
    if name is not None:
        bodies = [bodies[distinct_names(body.name for body in bodies).index(name)]]
    # Vertices are duplicated for faces of different normals.
    return joined(
        [RawScan(*merged_vertices(scale * body.vertices, body.faces), unit=unit) for body in bodies]
    )


def _names(read_scene: ReadScene, path: Path) -> tuple[str, ...]:
    return tuple(distinct_names(body.name for body in _scene(read_scene, path).bodies))


def _scene(read_scene: ReadScene, path: Path) -> Scene:
    try:
        scene = read_scene(path)
    except ScanReadError as error:
        raise incomplete(path, error.message) from error
    except ValueError as error:
        raise incomplete(path, error) from error
    if not scene.bodies:
        raise incomplete(path, "it holds no triangles")
    return scene


def _three_mf_scene(path: Path) -> Scene:
    try:
        with zipfile.ZipFile(path) as archive:
            check_archive(archive)
    except (OSError, MemoryError, ScanReadError):
        raise
    # A damaged archive raises whatever zipfile does: BadZipFile, NotImplementedError for its version, and
    # others.
    except Exception as error:
        raise ValueError(str(error)) from error
    bodies, unit = scene_bodies(path, "3mf")
    if unit is not None and unit not in UNITS:
        raise ValueError(f"its unit is {unit[:20]!r}")
    return Scene(bodies, None if unit is None else UNITS[unit])


def _collada_scene(path: Path) -> Scene:
    bodies, said = scene_bodies(path, "dae")
    if said is None:
        return Scene(bodies, None)
    metres = 1.0 if said == "meters" else float(said.split()[0])
    if not (math.isfinite(metres) and metres > 0):
        raise ValueError(f"its unit is {metres:g} m")
    unit = unit_of(metres)
    return Scene(bodies, unit) if unit else Scene(bodies, "m", metres)


THREE_MF = _format(".3mf", Extra("meshes", ("lxml", "networkx")), _three_mf_scene)
COLLADA = _format(".dae", Extra("meshes", ("collada",)), _collada_scene)
