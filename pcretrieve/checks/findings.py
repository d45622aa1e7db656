"""Points, surface and spectrum of a scan → checks, and the places that they name."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pcretrieve.checks import stages
from pcretrieve.checks.fit import Fit, between
from pcretrieve.checks.grading import Check
from pcretrieve.checks.layers import double_layers
from pcretrieve.points.grid import joined_by
from pcretrieve.points.neighbors import neighborhoods
from pcretrieve.surface import SurfaceMarks
from pcretrieve.values import FloatArray, PointCloud, Shape, TriangleMesh

# Number of neighbours with whose normals the normal of a point is compared.
N_NEIGHBORS = 8

# Largest distance of voxels that belong to one cut or bridge, relative to the diagonal.
PLACE = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """The checks of one scan, and the places that they name.

    spacing: median distance from a point to its nearest neighbour, unit of the file; 0 without points.
    filled: (m,) bool, faces of the surface without a point nearby.
    cuts, bridges: (k, 3) float64, places where parts of the surface that touch were separated, and where a
        loose part was connected.
    """

    checks: tuple[Check, ...] = ()
    spacing: float = 0.0
    filled: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    cuts: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    bridges: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))


def findings_of(
    cloud: PointCloud | None,
    mesh: TriangleMesh | None,
    marks: SurfaceMarks | None,
    shape: Shape | None,
    *,
    scan: PointCloud | None = None,
) -> Findings:
    """Check the results of the stages of a scan, up to some stage.

    scan: the points before they were thinned; without them, densities are those of the thinned points.
    Returns Findings: lengths are in the unit of the file.
    """
    checks: list[Check] = []
    spacing = 0.0
    filled = np.zeros(0 if mesh is None else len(mesh.faces), dtype=np.bool_)
    cuts = bridges = np.zeros((0, 3))
    if cloud is not None:
        around = neighborhoods(cloud.points, N_NEIGHBORS + 1, of_some=True)
        spacing = between(around)
        checks += stages.point_checks(cloud, spacing=spacing)
        if cloud.normals is not None:
            checks += stages.normal_checks(cloud.normals, around)
            checks.append(stages.layers_check(double_layers(cloud), cloud.diagonal))
        if mesh is not None:
            base = np.zeros((0, 3)) if marks is None else marks.base
            fit = Fit(cloud, around, mesh, cloud if scan is None else scan, base)
            filled = fit.filled
            checks += stages.fit_checks(fit)
            if len(base):
                area = fit.share(fit.on_base)
                checks.append(stages.base_check(area, on_ground=cloud.up is not None))
        if marks is not None:
            reach = PLACE * cloud.diagonal
            cuts, bridges = _places(marks.cuts, reach), _places(marks.bridges, reach)
            checks.append(stages.marks_check(len(cuts), len(bridges)))
    if mesh is not None:
        checks += [*stages.surface_checks(mesh), *stages.mesh_check(mesh.provenance)]
    if shape is not None:
        checks += stages.spectrum_checks(shape)
    return Findings(tuple(checks), spacing, filled, cuts, bridges)


def _places(cells: FloatArray, reach: float) -> FloatArray:
    """Centroids of groups of cells, (p, 3); cells nearer to each other than `reach` are in one group."""
    if not len(cells):
        return cells
    from scipy.spatial import cKDTree

    a, b = cKDTree(cells).query_pairs(reach, output_type="ndarray").T
    group = joined_by(a, b, len(cells))
    sums = np.stack([np.bincount(group, cells[:, axis]) for axis in range(3)], axis=1)
    return np.asarray(sums / np.bincount(group)[:, None])
