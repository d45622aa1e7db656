"""Oriented points, or a mesh with defects → closed surface: reconstruction and remeshing."""

from pcretrieve.surface.body import body_surfaces
from pcretrieve.surface.reconstruct import reduced, sampled, sound_mesh, surfaces
from pcretrieve.surface.tetwild import remesh

__all__ = [
    "body_surfaces",
    "reduced",
    "remesh",
    "sampled",
    "sound_mesh",
    "surfaces",
]
