"""Names that commands complete and check, without an import of what they name."""

from __future__ import annotations

from pcretrieve.plugins import Names

__all__ = ["METHODS", "NAMES", "UPWARD", "fused_names", "has_size", "known_method"]

#: The axes of files that may point upwards on pictures.
UPWARD = ("x", "-x", "y", "-y", "z", "-z")

#: The descriptors of pcretrieve by name, and whether their values have a size, without which the scale
#: "absolute" is not defined. The records in `pcretrieve.descriptors` say more.
METHODS: dict[str, bool] = {
    "r-bihdm": True,
    "bihdm": True,
    "bihdm-sampled": True,
    "shape-dna": True,
    "shape-dna-norm1": False,
    "shape-dna-norm1-values": False,
    "sd-gdm": True,
    "sd-gdm-sampled": True,
    "hks-bow": False,
    "hks-bow-spatial": False,
    "si-hks-bow": False,
    "si-hks-bow-spatial": False,
    "dl": False,
    "dl-supervised": False,
    "wks": False,
    "csd": False,
    "ispm": False,
    "hapt": False,
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
        Names(
            "matcher", "pcretrieve.matchers", ("heat-hausdorff", "hks-bow-gallery", "mds-cm-bof", "meshsift")
        ),
    )
}


def fused_names(method: str) -> tuple[str, ...]:
    """The names of the descriptors that a method fuses.

    Returns tuple of str: the names, in order.
    """
    return tuple(method.split("+"))


def known_method(method: str) -> str:
    """The method itself."""
    for name in fused_names(method):
        NAMES["descriptor"].known(name)
    return method


def has_size(method: str) -> bool:
    """Whether values of a method depend on the size of the body for the scale ``absolute``."""
    return any(METHODS.get(name, True) for name in fused_names(method))
