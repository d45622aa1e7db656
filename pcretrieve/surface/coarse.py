"""Oriented points → a coarse closed surface, which closes the holes of a scan."""

from __future__ import annotations

from pcretrieve.adapters import open3d
from pcretrieve.errors import ReconstructionError
from pcretrieve.options import SurfaceOptions
from pcretrieve.surface.caps import Capped, capped
from pcretrieve.surface.field import normals_of
from pcretrieve.surface.repair import largest_component
from pcretrieve.surface.topology import compact, defects
from pcretrieve.types import PointCloud

__all__ = ["coarse_surface"]

# Side of the cube of the coarse Poisson surface, relative to the longest side of the bounding box. Larger
# than the default of 1.1, so that holes at the border of the bounding box can be closed outside it; and
# larger again, if the surface is not closed, as where a body stands. See docs/decisions.md, BASE_SCALE.
FILL_SCALE = 1.5
BASE_SCALE = 2.0


def coarse_surface(cloud: PointCloud, options: SurfaceOptions, *, spacing: float) -> Capped:
    """Reconstruct a coarse Poisson surface, which decides far from the points.

    If it is not closed, as where a body stands, it is reconstructed in a larger cube. In large holes it is
    replaced by flat caps.

    Parameters
    ----------
    cloud : PointCloud
        Points with normals.
    options : SurfaceOptions
        Of which `fill_depth` is used.
    spacing : float
        Of the points; unit of the file.

    Returns
    -------
    Capped
        The surface, of which the largest component is closed, and its caps; unit of the file.

    Raises
    ------
    ReconstructionError
        If there is no surface, or it is not closed.
    """
    for scale in (FILL_SCALE, BASE_SCALE):
        vertices, faces, _ = open3d.poisson(
            cloud.points, normals_of(cloud), depth=options.fill_depth, scale=scale
        )
        if not len(faces):
            raise ReconstructionError(f"Poisson reconstruction of {len(cloud.points)} points gave no surface")
        surface = compact(vertices, faces)
        largest, _ = largest_component(surface, 1.0)
        if not (n_open := defects(largest).boundary_edges):
            return capped(surface, cloud, spacing=spacing)
    raise ReconstructionError(
        f"the points must surround a body, their surface has {n_open} boundary edges: "
        "scan the sides that are missing, or merge this view with others"
    )
