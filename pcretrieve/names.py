"""The names of what other packages can add, without an import of the records."""

from __future__ import annotations

from pcretrieve.plugins import Names

__all__ = ["METHODS", "NAMES"]

#: The descriptors of pcretrieve by name, and whether their values have a size, without which the scale
#: "absolute" is not defined. The records in `pcretrieve.descriptors` say more.
METHODS: dict[str, bool] = {
    "r-bihdm": True,
    "bihdm": True,
    "shape-dna": True,
    "shape-dna-norm1": False,
    "sd-gdm": True,
    "hks-bow": False,
    "hks-bow-spatial": False,
    "si-hks-bow": False,
    "si-hks-bow-spatial": False,
    "wks": False,
    "csd": False,
    "combined": True,
}

#: The names of what other packages can add, by kind. Tests hold them and the records against each other.
NAMES = {
    names.kind: names
    for names in (
        Names("element", "pcretrieve.elements", ("linear", "cubic", "intrinsic-delaunay", "points")),
        Names("point filter", "pcretrieve.point_filters", ("crop", "clean", "orient")),
        Names("surface method", "pcretrieve.surface_methods", ("growth", "poisson")),
        Names("surface filter", "pcretrieve.surface_filters", ("remesh",)),
        Names("descriptor", "pcretrieve.signatures", tuple(METHODS)),
        Names("distance", "pcretrieve.distances", ("log", "d1", "d2")),
        Names("matcher", "pcretrieve.matchers", ("heat-hausdorff",)),
        Names("executor", "pcretrieve.executors", ("processes",)),
        Names("store", "pcretrieve.stores", ("sqlite", "postgresql")),
    )
}
