"""The filters of surfaces, of pcretrieve and of other packages, by name."""

from __future__ import annotations

from pcretrieve.names import NAMES
from pcretrieve.options import SurfaceFilter
from pcretrieve.plugins import Registry, named
from pcretrieve.surface.remesh import REMESH

SURFACE_FILTERS: Registry[SurfaceFilter] = Registry(
    NAMES["surface filter"], {REMESH.name: REMESH}, named(SurfaceFilter)
)
