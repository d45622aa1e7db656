"""Points, surface and spectrum of a scan → checks, and the places that they name."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pcretrieve.checks import stages
from pcretrieve.checks.fit import Fit
from pcretrieve.checks.grading import Check
from pcretrieve.points.grid import joined_by
from pcretrieve.points.layers import Layers, double_layers
from pcretrieve.points.neighbors import nearest
from pcretrieve.surface import SurfaceMarks
from pcretrieve.values import FloatArray, PointCloud, Shape, TriangleMesh

# Largest distance of voxels that belong to one cut or bridge, relative to the diagonal.
PLACE = 0.02

# Number of points whose distance to the nearest neighbour is measured.
MEASURED = 5000


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """The checks of one scan, and the places that they name.

    spacing: median distance from a point to its nearest neighbour, unit of the file; 0 without points.
    layers: where points lie in several layers; None without normals.
    filled: (m,) bool, faces of the surface without a point nearby.
    cuts, bridges: (k, 3) float64, places where parts of the surface that touch were separated, and where a
        loose part was connected.
    """

    checks: tuple[Check, ...] = ()
    spacing: float = 0.0
    layers: Layers | None = None
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
    spacing, layers = 0.0, None
    filled = np.zeros(0 if mesh is None else len(mesh.faces), dtype=np.bool_)
    cuts = bridges = np.zeros((0, 3))
    if cloud is not None:
        spacing = _spacing(cloud)
        checks += stages.point_checks(cloud, spacing=spacing)
        if cloud.normals is not None:
            checks += stages.normal_checks(cloud.points, cloud.normals)
            layers = double_layers(cloud)
            checks.append(stages.layers_check(layers, cloud.diagonal))
        if mesh is not None:
            base = np.zeros((0, 3)) if marks is None else marks.base
            fit = Fit(cloud, mesh, cloud if scan is None else scan, base)
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
    return Findings(tuple(checks), spacing, layers, filled, cuts, bridges)


def _spacing(cloud: PointCloud) -> float:
    """Median distance from a point to its nearest neighbour."""
    step = max(1, len(cloud.points) // MEASURED)
    some = np.ascontiguousarray(cloud.points[::step])
    return float(np.median(nearest(cloud.points, some, 2)[0][:, 1]))


def _places(cells: FloatArray, reach: float) -> FloatArray:
    """Centroids of groups of cells, (p, 3); cells nearer to each other than `reach` are in one group."""
    if not len(cells):
        return cells
    from scipy.spatial import cKDTree

    a, b = cKDTree(cells).query_pairs(reach, output_type="ndarray").T
    group = joined_by(a, b, len(cells))
    sums = np.stack([np.bincount(group, cells[:, axis]) for axis in range(3)], axis=1)
    return np.asarray(sums / np.bincount(group)[:, None])
