"""Spectrum and surface → descriptor: one file per method, and the table that names them.

A method takes a shape and the options and gives a `Signature`. Other packages add their own by an entry point
of the group ``pcretrieve.signatures`` that leads to such a function::

    [project.entry-points."pcretrieve.signatures"]
    diameter = "their_package:diameter"

It is then a `--method` like any other. A name of pcretrieve's own cannot be taken.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import EntryPoint, entry_points
from typing import NamedTuple

import numpy as np

from pcretrieve.errors import OptionError, PcretrieveError, ShapeError
from pcretrieve.options import PLUGIN_GROUP, SignatureOptions, signature_methods
from pcretrieve.signatures.bihdm import bihdm, full_matrix
from pcretrieve.signatures.combined import combined
from pcretrieve.signatures.hks_bow import hks_bow
from pcretrieve.signatures.r_bihdm import r_bihdm, reduced_matrix
from pcretrieve.signatures.sd_gdm import sd_gdm
from pcretrieve.signatures.shape_dna import BY, shape_dna
from pcretrieve.signatures.wks import wks
from pcretrieve.types import Describable, ModalSpectrum, Signature, TriangleMesh

__all__ = [
    "METHODS",
    "bihdm",
    "combined",
    "describe",
    "full_matrix",
    "hks_bow",
    "r_bihdm",
    "reduced_matrix",
    "sd_gdm",
    "shape_dna",
    "wks",
]

Method = Callable[[Describable, SignatureOptions], Signature]


def _spectrum(shape: Describable, options: SignatureOptions) -> ModalSpectrum:
    """Of the surface in the unit of its file, where its size is to count."""
    return shape.spectrum.scaled(shape.area) if options.scale == "absolute" else shape.spectrum


def _bag(*, spatial: bool = False, scale_invariant: bool = False) -> Method:
    return lambda shape, options: hks_bow(
        shape.mesh, options.n_values, options.n_modes, spatial=spatial, scale_invariant=scale_invariant
    )


METHODS: dict[str, Method] = {
    "r-bihdm": lambda shape, o: r_bihdm(_spectrum(shape, o), o.n_values, o.n_modes, scale=o.scale),
    "bihdm": lambda shape, o: bihdm(_spectrum(shape, o), o.n_values, o.n_modes, scale=o.scale),
    "shape-dna": lambda shape, o: shape_dna(_spectrum(shape, o), o.n_values, normalized_by=BY[o.scale]),
    "shape-dna-norm1": lambda shape, o: shape_dna(shape.spectrum, o.n_values, normalized_by="first"),
    "sd-gdm": lambda shape, o: sd_gdm(shape.mesh, o.n_values, scale=o.scale),
    "hks-bow": _bag(),
    "hks-bow-spatial": _bag(spatial=True),
    "si-hks-bow": _bag(scale_invariant=True),
    "si-hks-bow-spatial": _bag(spatial=True, scale_invariant=True),
    "wks": lambda shape, o: wks(shape.spectrum, o.n_values, o.n_modes),
    "combined": lambda shape, o: combined(_spectrum(shape, o), o.n_values, o.n_modes, scale=o.scale),
}


# Those that see no more of a shape than its stored surface.
OF_MESH = ("sd-gdm", "hks-bow", "hks-bow-spatial", "si-hks-bow", "si-hks-bow-spatial")


def describe(shape: Describable, options: SignatureOptions) -> Signature:
    """The descriptor that `options` names.

    Where a scan was made into several surfaces, values are the geometric mean of theirs. Descriptors in
    `OF_MESH` describe the first surface alone. Where size has a weight w, the last value is area^w, unit
    length^(2w) of the file.

    Raises
    ------
    OptionError
        If there is no such descriptor, its package cannot be loaded, or a length does not fit the spectrum.
    ShapeError
        If the shape has none.
    """
    made = _one(shape, options)
    if options.method in OF_MESH or not shape.others:
        return made
    others = [
        _one(_Rebuilt(other.scaled(1.0), shape.area * other.area, shape.mesh, ()), options).values
        for other in shape.others
    ]
    logs = np.log([made.values, *others])
    return replace(made, values=np.exp(logs.mean(axis=0)), deviation=logs.std(axis=0, ddof=1))


class _Rebuilt(NamedTuple):
    """A shape by another of its surfaces."""

    spectrum: ModalSpectrum
    area: float
    mesh: TriangleMesh
    others: tuple[ModalSpectrum, ...]


def _one(shape: Describable, options: SignatureOptions) -> Signature:
    method = METHODS.get(options.method)
    made = method(shape, options) if method else _added(shape, options)
    if not options.size_weight:
        return made
    # Another package's error bar, where it has one, does not cover the size.
    return replace(made, values=np.append(made.values, shape.area**options.size_weight), deviation=None)


def _added(shape: Describable, options: SignatureOptions) -> Signature:
    """The descriptor of another package, which may fail in ways that nobody here has thought of."""
    point = next(iter(entry_points(group=PLUGIN_GROUP, name=options.method)), None)
    if point is None:
        raise OptionError(
            f"there is no descriptor {options.method!r}; there are {', '.join(signature_methods())}"
        )
    name = f"the descriptor {point.name!r} of the package {_package(point)}"
    try:
        method = point.load()
    except Exception as error:
        raise OptionError(
            f"{name} cannot be loaded, {type(error).__name__}: {error}; upgrade or uninstall that package"
        ) from error
    try:
        made = method(shape, options)
    except PcretrieveError:
        raise
    except Exception as error:
        raise ShapeError(f"{name} failed, {type(error).__name__}: {error}", stage="signature") from error
    if not isinstance(made, Signature) or not (made.values > 0).all():
        raise ShapeError(f"{name} must give a Signature of positive values, got {made!r}", stage="signature")
    return made


def _package(point: EntryPoint) -> str:
    return point.dist.name if point.dist else point.module
