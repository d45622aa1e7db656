"""Oriented points, or a mesh with defects → closed surface: reconstruction, repair, remeshing."""

from pcretrieve.surface.body import SurfaceMarks, body_surfaces
from pcretrieve.surface.reconstruct import sampled, sound_mesh, surfaces
from pcretrieve.surface.simplify import reduced
from pcretrieve.surface.tetwild import remesh
from pcretrieve.surface.topology import Defects, components, defects

__all__ = [
    "Defects",
    "SurfaceMarks",
    "body_surfaces",
    "components",
    "defects",
    "reduced",
    "remesh",
    "sampled",
    "sound_mesh",
    "surfaces",
]
