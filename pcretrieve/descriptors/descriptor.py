"""The record that declares a descriptor."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import get_args

import numpy as np

from pcretrieve.errors import OptionError
from pcretrieve.options import SignatureOptions
from pcretrieve.values import Metric, ModalSpectrum, Need, Shape, Signature
from pcretrieve.values.signatures import COORDINATES


@dataclass(frozen=True, slots=True)
class Descriptor:
    """The declaration of a descriptor, beside its function in pcretrieve or in another package.

    Attributes
    ----------
    name : str
        Value of the option `--method`.
    make : function of (Shape, SignatureOptions) that returns a Signature
        Called once for each surface of a shape, with a shape of that surface alone, which holds the parts in
        `needs` and no others; called once for a shape if the points are all that it needs.
    needs : tuple of {"spectrum", "overlaps", "eigenvectors", "mesh", "points"}
        The parts of a shape that `make` uses: `Shape.spectrum`; its `ModalSpectrum.overlaps`, which the
        catalogue computes from the mesh where it does not keep them; `Shape.eigenpairs`, which are the
        `SignatureOptions.n_modes` + 1 smallest by linear elements, with one row for each vertex of the mesh;
        `Shape.mesh`; or `Shape.points`, which the catalogue does not store.
    has_size : bool, default True
        Whether the values for the scale ``absolute`` depend on the size of the body. If not, that scale is
        refused.
    length : function of SignatureOptions that returns int
        L, the number of values; by default `SignatureOptions.n_values`.
    metric : {"logarithms", "values", "histograms"}, default "logarithms"
        How the values are compared, as in `Signature`.
    spread : float, default 1.0
        What the coordinates of the descriptor are divided by where it is fused with others (`--method A+B`):
        the square root of the total variance of the coordinates, which distances compare, over simulated
        people, whose scans the benchmarks do not use. See docs/decisions.md, spread.

    Raises
    ------
    OptionError
        If there is no such need or metric, or the spread is not positive.
    """

    name: str
    make: Callable[[Shape, SignatureOptions], Signature]
    needs: tuple[Need, ...]
    has_size: bool = True
    length: Callable[[SignatureOptions], int] = attrgetter("n_values")
    metric: Metric = "logarithms"
    spread: float = 1.0

    def __post_init__(self) -> None:
        for what, given, known in (
            ("needs", set(self.needs), get_args(Need)),
            ("metric", {self.metric}, get_args(Metric)),
        ):
            if wrong := sorted(given.difference(known)):
                raise OptionError(
                    f"{what} of a descriptor must be of {', '.join(known)}, got {wrong[0]!r}"
                )
        if not self.spread > 0:
            raise OptionError(
                f"spread of a descriptor must be positive, got {self.spread:g}"
            )


def check_modes(n_modes: int, n_pairs: int, *, least: int = 1) -> None:
    """Raise OptionError unless there are an eigenpair for each mode and one for the constant."""
    if not least <= n_modes < n_pairs:
        raise OptionError(
            f"n_modes must be between {least} and {n_pairs - 1} for {n_pairs} eigenpairs, got {n_modes}"
        )


def spectrum_of(shape: Shape, options: SignatureOptions) -> ModalSpectrum:
    """The spectrum of the surface on unit area; for the scale ``absolute``, in the unit of the file."""
    return (
        shape.spectrum.scaled(shape.area)
        if options.scale == "absolute"
        else shape.spectrum
    )


def fused(parts: Sequence[Descriptor]) -> Descriptor:
    """The descriptor whose values are those of several descriptors."""
    name = "+".join(part.name for part in parts)

    def make(shape: Shape, options: SignatureOptions) -> Signature:
        made = [part.make(shape, options) for part in parts]
        scaled = [
            COORDINATES[signature.metric](signature.values) / part.spread
            for part, signature in zip(parts, made, strict=True)
        ]
        digest = ", ".join(f"{signature.kind} {signature.digest}" for signature in made)
        return Signature(
            np.concatenate(scaled), kind=name, digest=digest, metric="values"
        )

    return Descriptor(
        name=name,
        make=make,
        needs=tuple(dict.fromkeys(need for part in parts for need in part.needs)),
        has_size=any(part.has_size for part in parts),
        length=lambda options: sum(part.length(options) for part in parts),
        metric="values",
    )
