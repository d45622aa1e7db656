"""OFF, STL and GLB, read by trimesh."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pcretrieve.scan.raw import RawScan, incomplete

__all__ = ["read_mesh"]

# Formats that repeat a vertex for each face or normal that it takes part in.
REPEATS_VERTICES = frozenset({".stl", ".glb"})


def read_mesh(path: Path) -> RawScan:
    """Vertices and triangles of an OFF, STL or GLB file; larger polygons are cut into triangles."""
    import trimesh

    try:
        mesh: Any = trimesh.load(path, file_type=path.suffix[1:].lower(), process=False, force="mesh")
        vertices = np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3)
        faces = np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
    except (OSError, MemoryError):
        raise
    # trimesh has no exception of its own: a broken file surfaces as whatever its parser met.
    except Exception as error:
        raise incomplete(path, error) from error
    if not len(vertices):
        raise incomplete(path, "it holds no vertices")
    if path.suffix.lower() in REPEATS_VERTICES:
        vertices, inverse = np.unique(vertices, axis=0, return_inverse=True)
        faces = inverse.reshape(-1)[faces]
    return RawScan(vertices, faces if len(faces) else None)
