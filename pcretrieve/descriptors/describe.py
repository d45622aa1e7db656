"""The table of descriptors, and their application to shapes.

Another package adds a record `Descriptor` by an entry point of the group ``pcretrieve.descriptors``, as in
CONTRIBUTING.md; the name of the entry point is then a value of the option `--method`. Instead of a record,
the entry point may name a function of a shape and `SignatureOptions`, which is taken as a descriptor that
needs the spectrum, its overlaps and the mesh, and returns `SignatureOptions.n_values` positive values.

Names joined by ``+, such as ``hapt+r-bihdm``, stand for the fusion of these descriptors.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from pcretrieve.descriptors.bihdm import BIHDM
from pcretrieve.descriptors.csd import CSD, WKS
from pcretrieve.descriptors.descriptor import Descriptor, fused
from pcretrieve.descriptors.hapt import HAPT, MOMENTS
from pcretrieve.descriptors.r_bihdm import R_BIHDM
from pcretrieve.descriptors.shape_dna import SHAPE_DNA
from pcretrieve.errors import OptionError, ShapeError, Stage
from pcretrieve.options import SignatureOptions, fused_names
from pcretrieve.plugins import DESCRIPTOR_NAMES, Registry
from pcretrieve.spectral import unit_eigenpairs
from pcretrieve.values import (
    UNIT,
    Eigenpairs,
    ModalSpectrum,
    Shape,
    Signature,
    SizeUnit,
    Surface,
    TriangleMesh,
)
from pcretrieve.values.base import check_type

#: A descriptor of one's own: a function of a surface, in the unit of the file, that returns numbers.
MeshFunction: TypeAlias = Callable[[TriangleMesh], ArrayLike]


def _checked(name: str, added: object) -> Descriptor:
    """The record of another package, or a record for its function."""
    if callable(added):
        return Descriptor(name, added, needs=("spectrum", "overlaps", "mesh"))
    if not isinstance(added, Descriptor):
        raise TypeError(f"must be of the class Descriptor, got {added!r}")
    if added.name != name:
        raise TypeError(
            f"must have the name of its entry point, got a record named {added.name!r}"
        )
    return added


class _Descriptors(Registry[Descriptor]):
    """The descriptors by name, and their fusions by several names."""

    def __getitem__(self, name: str) -> Descriptor:
        """The record of a name, or of the fusion of several names; OptionError as by `Registry`."""
        records = [
            super(_Descriptors, self).__getitem__(part) for part in fused_names(name)
        ]
        return records[0] if len(records) == 1 else fused(records)

    def called(self, name: str) -> str:
        """The descriptor in a message; of a fusion, without the packages of its parts."""
        return (
            super().called(name)
            if len(fused_names(name)) == 1
            else f"the descriptor {name!r}"
        )

    def version(self, name: str) -> str:
        """The packages and the versions of all parts that other packages add."""
        version = super().version
        return "".join(version(part) for part in fused_names(name))


DESCRIPTORS: Registry[Descriptor] = _Descriptors(
    DESCRIPTOR_NAMES,
    {
        record.name: record
        for record in (R_BIHDM, BIHDM, SHAPE_DNA, WKS, CSD, HAPT, MOMENTS)
    },
    _checked,
)


def describe(
    shape: Shape,
    options: SignatureOptions,
    method: Descriptor | MeshFunction | None = None,
) -> Signature:
    """The signature of a shape by the method and the parameters in `options`.

    If several surfaces were reconstructed from one scan, the method describes each surface, and each value is
    the mean over the surfaces: the geometric mean for the metric ``logarithms``, else the arithmetic mean. A
    method that needs the points alone describes the scan once.

    Parameters
    ----------
    shape : Shape
        With the parts that the method needs; eigenvectors that are missing are computed from the mesh.
    options : SignatureOptions
        The method, the number of values and of modes, the scale, and the weight w of the size.
    method : Descriptor or function, optional
        A descriptor of your own in place of that of `options`, or a function of a `TriangleMesh` in the unit
        of the file, whose numbers are compared as they are.

    Returns
    -------
    Signature
        In the order and the units of the method. If w > 0, the last value is the size: area^w, unit
        length^(2 w) of the shape, for the metric ``logarithms``, and w log area for ``values``.
        `Signature.unit` is the unit of length, if values depend on the size.
        `Signature.errors` is None if there is one surface only.

    Raises
    ------
    OptionError
        If the method does not exist, its package cannot be loaded, or the number of values or of modes does
        not fit the spectrum.
    ShapeError
        If the shape lacks a part that the method needs, or its signature cannot be computed.
    """
    check_type("shape", shape, Shape)
    check_type("options", options, SignatureOptions)
    if callable(method):
        return _mean([_measured(method, part.mesh) for part in shape.apart()])
    descriptor = method or DESCRIPTORS[options.method]
    _check_size(descriptor, options)
    parts = (shape,) if set(descriptor.needs) == {"points"} else shape.apart()
    unit = _unit_of_sizes(shape) if options.compares_sizes else None
    return _mean(
        [replace(_described(descriptor, part, options), unit=unit) for part in parts]
    )


def _mean(made: Sequence[Signature]) -> Signature:
    """The mean of the signatures of the surfaces of one scan, with its error bar."""
    first = made[0]
    if len(made) == 1:
        return first
    rows = np.array([signature.values for signature in made])  # (s, L)
    if first.metric == "logarithms":
        logs = np.log(rows)
        return replace(
            first, values=np.exp(logs.mean(axis=0)), errors=logs.std(axis=0, ddof=1)
        )
    return replace(first, values=rows.mean(axis=0), errors=rows.std(axis=0, ddof=1))


def _measured(function: MeshFunction, mesh: TriangleMesh) -> Signature:
    """What a function of one's own says of one surface."""
    name = getattr(function, "__name__", type(function).__name__)
    with DESCRIPTORS.blamed(name, Stage.SIGNATURE):
        return Signature(
            np.atleast_1d(np.asarray(function(mesh))), kind=name, metric="values"
        )


def signature_length(options: SignatureOptions) -> int:
    """The number of values of the signatures that `describe` returns."""
    return DESCRIPTORS[options.method].length(options) + bool(options.size_weight)


def _unit_of_sizes(shape: Shape) -> SizeUnit:
    return "m" if any(UNIT in step.sizes for step in shape.provenance) else "unknown"


def _check_size(descriptor: Descriptor, options: SignatureOptions) -> None:
    if options.scale == "absolute" and not descriptor.has_size:
        raise OptionError(
            f"scale must be area or relative for {descriptor.name}, which has no size to keep"
        )
    if options.size_weight and descriptor.metric == "histograms":
        raise OptionError(
            f"size_weight must be 0 for {descriptor.name}, whose values are a histogram, got "
            f"{options.size_weight:g}: a size is no share of it"
        )


def with_overlaps(shape: Shape, element: str) -> Shape:
    """The shape with the overlaps of its eigenfunctions, from its meshes as far as it has some."""
    from threadpoolctl import threadpool_limits

    surfaces = [*shape.surfaces]
    for at, surface in enumerate(surfaces):
        spectrum = surface.spectrum
        if (
            surface.mesh is not None
            and spectrum is not None
            and spectrum.overlaps is None
        ):
            # As in the pipeline, so that rounding errors are the same.
            with threadpool_limits(limits=1):
                pairs = unit_eigenpairs(surface.mesh, len(spectrum.eigenvalues), element)
                overlaps = ModalSpectrum.of(pairs).overlaps
            surfaces[at] = replace(surface, spectrum=replace(spectrum, overlaps=overlaps))
    return replace(shape, surfaces=tuple(surfaces))


def _described(
    descriptor: Descriptor, part: Shape, options: SignatureOptions
) -> Signature:
    """The signature of one surface."""
    needed = _needed(descriptor, part, options)
    with DESCRIPTORS.blamed(descriptor.name, Stage.SIGNATURE):
        made = descriptor.make(needed, options)
    length, wrong = descriptor.length(options), None
    if not isinstance(made, Signature) or made.metric != descriptor.metric:
        wrong = f"a Signature with the metric {descriptor.metric!r}, got {made!r}"
    elif len(made.values) != length:
        wrong = f"{length} values, as its record declares, got {len(made.values)}"
    if wrong:
        raise ShapeError(
            f"{DESCRIPTORS.called(descriptor.name)} must give {wrong}",
            stage=Stage.SIGNATURE,
        )
    if not options.size_weight:
        return made
    logarithm = options.size_weight * np.log(part.area)
    size = (
        part.area**options.size_weight if descriptor.metric == "logarithms" else logarithm
    )
    # The error bar that a method of another package may return has no entry for the size.
    return replace(made, values=np.append(made.values, size), errors=None)


def _needed(descriptor: Descriptor, part: Shape, options: SignatureOptions) -> Shape:
    """A shape of one surface with the parts that the descriptor needs, and no others."""
    # With others, a need that is missing in the record would show only for shapes of a catalogue.
    needs = set(descriptor.needs)
    spectrum = part.spectrum if {"spectrum", "overlaps"} & needs else None
    if spectrum is not None and "overlaps" not in needs:
        spectrum = replace(spectrum, overlaps=None)
    mesh = part.mesh if "mesh" in needs else None
    pairs = _lowest_pairs(part, options.n_modes + 1) if "eigenvectors" in needs else None
    cloud = part.points if "points" in needs else None
    surface = Surface(part.area, spectrum, mesh, pairs)
    return replace(part, surfaces=(surface,), cloud=cloud, grade=None)


def _lowest_pairs(part: Shape, n_pairs: int) -> Eigenpairs:
    """The smallest eigenpairs: those of the shape, if it has enough of them, else those of its mesh."""
    kept = part.surfaces[0].eigenpairs
    if kept is None or len(kept.eigenvalues) < n_pairs:
        return unit_eigenpairs(part.mesh, n_pairs)
    return kept.lowest(n_pairs)
