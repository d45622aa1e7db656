"""Oriented points, or a mesh with defects → closed surface: reconstruction, repair, remeshing."""

from pcretrieve.options import SurfaceFilter
from pcretrieve.surface.body import SurfaceMarks, body_surfaces
from pcretrieve.surface.filters import SURFACE_FILTERS
from pcretrieve.surface.reconstruct import (
    SURFACE_METHODS,
    SurfaceMethod,
    poisson_surface,
    sampled,
    sound_mesh,
    surfaces,
)
from pcretrieve.surface.remesh import remesh
from pcretrieve.surface.repair import repaired
from pcretrieve.surface.simplify import reduced
from pcretrieve.surface.topology import Defects, defects

__all__ = [
    "SURFACE_FILTERS",
    "SURFACE_METHODS",
    "Defects",
    "SurfaceFilter",
    "SurfaceMarks",
    "SurfaceMethod",
    "body_surfaces",
    "defects",
    "poisson_surface",
    "reduced",
    "remesh",
    "repaired",
    "sampled",
    "sound_mesh",
    "surfaces",
]
