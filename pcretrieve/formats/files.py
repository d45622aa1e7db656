"""A file, or geometry of another package → a point cloud or a mesh with checked arrays; and the reverse."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import InputError, ScanReadError
from pcretrieve.formats.format import RawScan
from pcretrieve.formats.registry import FORMATS, ScanPath, read_raw, suffixes
from pcretrieve.formats.remote import local_copy
from pcretrieve.values import (
    METRES,
    UNIT,
    FloatArray,
    PointCloud,
    Step,
    TriangleMesh,
    welded,
)
from pcretrieve.values.base import UNIT_KEPT, UNIT_TAKEN, check_type
from pcretrieve.values.conversion import GeometryLike, as_cloud, as_geometry, as_mesh
from pcretrieve.values.files import check_target, write_file

#: A file, or what can be converted to a point cloud or a surface.
ScanLike: TypeAlias = "str | Path | ScanPath | GeometryLike"

# Limits of the largest coordinate: products of six lengths, such as squares of
# volumes, stay in the range of float64.
LARGEST_COORDINATE = 1e50
SMALLEST_COORDINATE = 1e-50


def read_scan(path: str | Path) -> PointCloud | TriangleMesh:
    """Read a scan.

    Parameters
    ----------
    path : str or Path
        Points: ``.ply .pcd``, tables ``.txt .csv .asc .xyz .xyzn .xyzrgb .pts``, grids ``.ptx``, arrays
        ``.npy .npz``, laser scans ``.las``, and ``.laz .e57`` by the extras ``las`` and ``e57``, depth
        images ``.png .tif .npy``, or the posed range scans that a Stanford ``.conf`` merges.
        Meshes: ``.ply .obj .off .stl .glb .gltf``, and ``.3mf .dae`` by the extra ``meshes``.
        ``file#name`` is one of several scans in a file; the file itself is all of them as one. A path may be
        a URL, such as ``s3://bucket/scan.ply``, of ``http https s3 file``, by the extra ``remote``.

    Returns
    -------
    PointCloud or TriangleMesh
        A mesh, if the file has faces; in metres if the format has a unit, else in the unit of the file.
        Points with NaN or infinite coordinates, which depth cameras write for missing measurements, are
        removed, and the provenance has their number.

    Raises
    ------
    ScanReadError
        If the file does not exist, cannot be read, is not of the format of its
        suffix, is truncated, or is empty.
    """
    check_type("path", path, str, Path)
    return _read(ScanPath.parse(path))


def _read(scan: ScanPath, given: str = "none") -> PointCloud | TriangleMesh:
    """Read a scan, in metres if its unit is known: that of the file, or else the given one."""
    started = time.perf_counter()
    try:
        # Invalid numbers may be signalling NaN, or overflow when squared; `_scan` removes non-finite points.
        with np.errstate(all="ignore"), local_copy(scan) as copied:
            raw = read_raw(copied)
            is_free = given != "none" and (raw.unit is None or raw.is_assumed)
            if is_free and raw.unit not in (None, given):
                note = f"--unit {given} {UNIT_TAKEN} {raw.unit}"
                raw = raw._replace(notes=(*raw.notes, note))
            return _in_metres(
                _scan(raw, started=started), given if is_free else raw.unit, given
            )
    except ScanReadError as error:
        if str(scan) in error.message:
            raise
        raise ScanReadError(f"{scan}: {error.message}") from error


def located(scan: ScanLike) -> ScanPath | GeometryLike:
    """The place of a scan in a file, or geometry as it is given."""
    return ScanPath.parse(scan) if isinstance(scan, (str, Path)) else scan


def as_scan(scan: ScanLike, unit: str = "none") -> PointCloud | TriangleMesh:
    """Read a scan from a path, or convert a value to a scan; in metres if the unit is known."""
    scan = located(scan)
    if isinstance(scan, ScanPath):
        return _read(scan, unit)
    value = as_geometry(scan)
    if unit == "none" or any(UNIT in step.sizes for step in value.provenance):
        return value
    return _in_metres(value, unit)


def _in_metres(
    value: PointCloud | TriangleMesh, unit: str | None, given: str = "none"
) -> PointCloud | TriangleMesh:
    """A scan in metres, and the length of the unit for the provenance, if the unit is known.

    given: the unit that is asked for, of which a note tells if it is not that of the scan.
    """
    if unit is None:
        return value
    metres = METRES[unit]
    notes = (f"converted the coordinates from {unit} to m",) if metres != 1 else ()
    if given not in ("none", unit):
        notes = (*notes, f"--unit {given} {UNIT_KEPT}, {unit}")
    first, *others = value.provenance or (Step("read", 0.0),)
    read = replace(first, sizes=first.sizes | {UNIT: 1.0}, notes=(*first.notes, *notes))
    provenance = (read, *others)
    if isinstance(value, TriangleMesh):
        return replace(value, vertices=value.vertices * metres, provenance=provenance)
    viewpoints = None if value.viewpoints is None else value.viewpoints * metres
    points = value.points * metres
    return replace(value, points=points, viewpoints=viewpoints, provenance=provenance)


def _scan(raw: RawScan, *, started: float) -> PointCloud | TriangleMesh:
    """A cloud or a mesh with finite points, valid faces and unit normals, from the arrays of a file."""
    n = len(raw.points)
    notes = list(raw.notes)
    kept = np.isfinite(raw.points).all(axis=1)  # (n,)

    def of_points(rows: NDArray[Any]) -> NDArray[Any]:
        return rows if kept.all() else rows[kept]

    points = of_points(raw.points)
    if len(points) < n:
        notes.append(f"dropped {n - len(points)} of {n} points that were NaN or infinite")
    if not len(points):
        held = (
            f"all {n} of this one are NaN or infinite"
            if n
            else "this one has none at all"
        )
        raise ScanReadError(f"a scan must have points with finite coordinates, {held}")
    largest = np.abs(points).max()
    if largest > LARGEST_COORDINATE or 0 < largest < SMALLEST_COORDINATE:
        raise ScanReadError(
            f"coordinates must be {SMALLEST_COORDINATE:g} to {LARGEST_COORDINATE:g} in size, so that areas "
            f"and volumes are numbers too, got {largest:g}: give the scan in another unit"
        )

    if raw.faces is not None:
        points, faces = _valid_faces(points, kept, raw.faces)
        if len(faces):
            sizes: dict[str, float] = {"vertices": n, "faces": len(raw.faces)}
            step = Step("read", time.perf_counter() - started, sizes, tuple(notes))
            return TriangleMesh(points, faces, (step,))
        notes.append("took the vertices as points: no face has three of them")

    normals = (
        None if raw.normals is None else _unit_normals(of_points(raw.normals), notes)
    )
    viewpoints = None
    if raw.viewpoints is not None:
        viewpoints = _finite_viewpoints(
            of_points(np.broadcast_to(raw.viewpoints, (n, 3))), notes
        )
    step = Step("read", time.perf_counter() - started, {"points": n}, tuple(notes))
    return PointCloud(points, normals, viewpoints, (step,))


def _valid_faces(
    points: FloatArray, kept: NDArray[np.bool_], faces: NDArray[Any]
) -> tuple[FloatArray, NDArray[np.int32]]:
    """The faces whose vertices are all kept, and the kept points, with those that coincide welded."""
    n = len(kept)
    if faces.size and (faces.min() < 0 or faces.max() >= n):
        raise ScanReadError(
            f"faces must name vertices 0 to {n - 1}, got {faces.min()} to {faces.max()}"
        )
    if len(points) < n:
        numbers = np.cumsum(kept) - 1  # (n,), of the vertices that are left
        faces = numbers[faces[kept[faces].all(axis=1)]]
    if not len(faces):
        return points, faces.astype(np.int32)
    points, faces = welded(points, faces.astype(np.int64))
    return points, faces.astype(np.int32)


def _unit_normals(normals: FloatArray, notes: list[str]) -> FloatArray | None:
    """The normals, scaled to unit length; None if one has no direction."""
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    usable = np.isfinite(length) & (length > 0)
    if usable.all():
        return np.asarray(normals / length)
    notes.append(
        f"ignored the file's normals: {int((~usable).sum())} of them have no direction"
    )
    return None


def _finite_viewpoints(viewpoints: FloatArray, notes: list[str]) -> FloatArray | None:
    """The positions of the sensors, unless one is no place."""
    if (np.abs(viewpoints) <= LARGEST_COORDINATE).all():
        return viewpoints
    notes.append(
        "ignored the file's sensor positions: some are NaN, infinite or beyond "
        f"{LARGEST_COORDINATE:g}"
    )
    return None


# --- writing ----------------------------------------------------------------------------------------------

Kind = Literal["point", "mesh"]


def write_cloud(cloud: GeometryLike, path: str | Path) -> None:
    """Write points with their normals and the positions of their sensors, in one atomic step.

    Parameters
    ----------
    cloud : GeometryLike
        The points; their unit is that of the file.
    path : str or Path
        The file. ``.ply`` (double precision) and ``.pcd`` (single precision) store the position of the sensor
        of each point in fields ``vp_x vp_y vp_z``, as PCL's PointWithViewpoint. ``.xyzn`` stores points and
        normals with nine digits. An existing file is replaced.

    Raises
    ------
    InputError
        If no format of the suffix stores point clouds, it is ``.xyzn`` and the points have no normals, or the
        file cannot be written.
    """
    _write(as_cloud(cloud), Path(path), "point")


def write_mesh(mesh: GeometryLike, path: str | Path) -> None:
    """Write a mesh, in one atomic step.

    Parameters
    ----------
    mesh : GeometryLike
        The mesh, of this package or another (see `as_mesh`); its unit is that of the file.
    path : str or Path
        The file, with one of the suffixes ``.ply .obj .off .stl .glb``. An existing file is replaced.

    Raises
    ------
    InputError
        If no format of the suffix stores meshes, or the file cannot be written.
    """
    _write(as_mesh(mesh), Path(path), "mesh")


def check_output(
    path: Path, sources: Sequence[Path] = (), kind: Kind | None = None
) -> None:
    """Check, before a long computation, that its result can be written."""
    if kind is not None:
        _writer(path, kind)
    check_target(path, sources)


def _write(value: PointCloud | TriangleMesh, path: Path, kind: Kind) -> None:
    suffix = path.suffix.lower()
    write = _writer(path, kind)
    try:
        data = write(value)
    except (InputError, MemoryError):
        raise
    except Exception as error:
        if suffix in FORMATS.own:
            raise
        raise InputError(
            f"{FORMATS.called(suffix)} failed, {type(error).__name__}: {error}"
        ) from error
    write_file(path, data)


def _writer(path: Path, kind: Kind) -> Callable[[Any], bytes]:
    """The function that makes the content of a file; InputError if there is none."""
    suffix = path.suffix.lower()
    name = "write_cloud" if kind == "point" else "write_mesh"
    write: Callable[[Any], bytes] | None = (
        getattr(FORMATS[suffix], name) if suffix in suffixes() else None
    )
    if write is None:
        known = " ".join(
            suffix for suffix, found in FORMATS.own.items() if getattr(found, name)
        )
        raise InputError(f"a {kind} file must end in one of {known}, got {path.name}")
    return write
