"""Spectrum and surface → global shape descriptor: one module for each method, and a table of the methods.

A method is a function of a shape and `SignatureOptions` that returns a `Signature`. Another package adds a
method by an entry point of the group ``pcretrieve.signatures`` that names such a function::

    [project.entry-points."pcretrieve.signatures"]
    diameter = "other_package:diameter"

The name of the entry point is then a value of the option `--method`. The names of pcretrieve's own methods
are reserved.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import EntryPoint, entry_points
from typing import NamedTuple

import numpy as np

from pcretrieve.descriptors.bihdm import bihdm, full_matrix
from pcretrieve.descriptors.combined import combined
from pcretrieve.descriptors.hks_bow import hks_bow
from pcretrieve.descriptors.r_bihdm import r_bihdm, reduced_matrix
from pcretrieve.descriptors.sd_gdm import sd_gdm
from pcretrieve.descriptors.shape_dna import BY, shape_dna
from pcretrieve.descriptors.wks import wks
from pcretrieve.errors import OptionError, PcretrieveError, ShapeError
from pcretrieve.options import PLUGIN_GROUP, SignatureOptions, signature_methods
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
    """The spectrum of the surface on unit area; for the scale ``absolute``, in the unit of the file."""
    return shape.spectrum.scaled(shape.area) if options.measured_by == "absolute" else shape.spectrum


def _bag(*, spatial: bool = False, scale_invariant: bool = False) -> Method:
    return lambda shape, options: hks_bow(
        shape.mesh, options.n_values, options.n_modes, spatial=spatial, scale_invariant=scale_invariant
    )


METHODS: dict[str, Method] = {
    "r-bihdm": lambda shape, o: r_bihdm(_spectrum(shape, o), o.n_values, o.n_modes, scale=o.measured_by),
    "bihdm": lambda shape, o: bihdm(_spectrum(shape, o), o.n_values, o.n_modes, scale=o.measured_by),
    "shape-dna": lambda shape, o: shape_dna(_spectrum(shape, o), o.n_values, normalized_by=BY[o.measured_by]),
    "shape-dna-norm1": lambda shape, o: shape_dna(shape.spectrum, o.n_values, normalized_by="first"),
    "sd-gdm": lambda shape, o: sd_gdm(shape.mesh, o.n_values, scale=o.measured_by),
    "hks-bow": _bag(),
    "hks-bow-spatial": _bag(spatial=True),
    "si-hks-bow": _bag(scale_invariant=True),
    "si-hks-bow-spatial": _bag(spatial=True, scale_invariant=True),
    "wks": lambda shape, o: wks(shape.spectrum, o.n_values, o.n_modes),
    "combined": lambda shape, o: combined(_spectrum(shape, o), o.n_values, o.n_modes, scale=o.measured_by),
}


# Methods that are computed from the stored surface instead of the stored spectrum.
OF_MESH = ("sd-gdm", "hks-bow", "hks-bow-spatial", "si-hks-bow", "si-hks-bow-spatial")


def describe(shape: Describable, options: SignatureOptions) -> Signature:
    """The signature of a shape by the method and the parameters in `options`.

    If several surfaces were reconstructed from one scan, each value is the geometric mean over the surfaces;
    the methods in `OF_MESH` describe the first surface only.

    Parameters
    ----------
    shape : Describable
        The spectrum, the area and the surface of the shape, and the spectra of its further surfaces.
    options : SignatureOptions
        The method, the number of values and of modes, the scale, and the weight w of the size.

    Returns
    -------
    Signature
        In the order and the units of the method. If w > 0, area^w is appended as the last value, unit
        length^(2 w) of the file. `Signature.deviation` is None if there is one surface only.

    Raises
    ------
    OptionError
        If the method does not exist, its package cannot be loaded, or the number of values or of modes does
        not fit the spectrum.
    ShapeError
        If the signature of this shape cannot be computed.
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
    """The shape with one of its further surfaces in the place of the first."""

    spectrum: ModalSpectrum
    area: float
    mesh: TriangleMesh
    others: tuple[ModalSpectrum, ...]


def _one(shape: Describable, options: SignatureOptions) -> Signature:
    method = METHODS.get(options.method)
    made = method(shape, options) if method else _added(shape, options)
    if not options.size_weight:
        return made
    # The error bar that a method of another package may return has no entry for the size.
    return replace(made, values=np.append(made.values, shape.area**options.size_weight), deviation=None)


def _added(shape: Describable, options: SignatureOptions) -> Signature:
    """The signature by a method of another package; any exception there becomes one of `errors`."""
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
