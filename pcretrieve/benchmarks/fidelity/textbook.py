"""A textbook pipeline from points to a spectrum, for comparison: Poisson reconstruction and fTetWild."""

from __future__ import annotations

import time
from pathlib import Path

from pcretrieve.adapters import lapy, tetwild
from pcretrieve.adapters.open3d import (
    estimate_normals,
    orient_by_tangent_planes,
    poisson,
    statistical_inliers,
)
from pcretrieve.errors import BenchmarkError
from pcretrieve.formats import read_scan
from pcretrieve.spectral import eigenpairs, laplace_beltrami
from pcretrieve.surface.remesh import boundary_faces
from pcretrieve.surface.topology import compact
from pcretrieve.values import PointCloud

__all__ = ["textbook_seconds"]

# Parameters for which the libraries have no default.
OUTLIER_NEIGHBORS, OUTLIER_RATIO, TANGENT_NEIGHBORS, DEPTH, N_PAIRS = 20, 2.0, 30, 8, 61

# Defaults of Open3D: neighbours of a plane, size of the octree's cube relative to the points' bounding cube.
PLANE_NEIGHBORS, CUBE = 30, 1.1

# Defaults of fTetWild: edge length and envelope, relative to the diagonal.
EDGE_LENGTH, ENVELOPE = 0.05, 1e-3


def textbook_seconds(path: Path, timeout: float) -> float:
    """Wall-clock time of a textbook pipeline, from a file of points to 61 eigenpairs.

    Its stages are statistical outlier removal, normals oriented by tangent planes, Poisson reconstruction,
    fTetWild with its defaults, and LaPy on the boundary of the tetrahedra; if LaPy is not installed,
    `eigenpairs`.

    Parameters
    ----------
    path : Path
        The points.
    timeout : float
        Longest time that fTetWild may take; seconds.

    Returns
    -------
    float
        Time in seconds.

    Raises
    ------
    BenchmarkError
        If the file holds a mesh.
    RemeshError
        If fTetWild gives no tetrahedra, or exceeds the time limit.
    """
    tetwild.start()
    started = time.perf_counter()
    cloud = read_scan(path)
    if not isinstance(cloud, PointCloud):
        raise BenchmarkError(f"the textbook pipeline begins with points, got a mesh: {path}")
    points = cloud.points[
        statistical_inliers(cloud.points, n_neighbors=OUTLIER_NEIGHBORS, std_ratio=OUTLIER_RATIO)
    ]
    normals = estimate_normals(points, n_neighbors=PLANE_NEIGHBORS)
    normals = orient_by_tangent_planes(points, normals, n_neighbors=TANGENT_NEIGHBORS)
    vertices, faces, _ = poisson(points, normals, depth=DEPTH, scale=CUBE)
    nodes, tetrahedra = tetwild.tetrahedralize(
        vertices, faces, edge_length=EDGE_LENGTH, envelope=ENVELOPE, optimize=True, timeout=timeout
    )
    boundary = compact(nodes, boundary_faces(nodes, tetrahedra))
    if lapy.is_installed():
        lapy.eigenvalues(boundary.vertices, boundary.faces, N_PAIRS)
    else:
        eigenpairs(laplace_beltrami(boundary), N_PAIRS)
    return time.perf_counter() - started
