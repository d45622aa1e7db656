"""The options of what a catalogue stores."""

from __future__ import annotations

from typing import Annotated, Literal, get_args

from pydantic import AfterValidator

from pcretrieve.options.model import Options

__all__ = ["CatalogueOptions", "Kept"]

Kept = Literal["meshes", "overlaps"]


def _in_order(keep: tuple[Kept, ...]) -> tuple[Kept, ...]:
    """Each part once, so that two lists of the same parts are equal."""
    return tuple(part for part in get_args(Kept) if part in keep)


class CatalogueOptions(Options):
    """What is stored of a shape beside its spectra. No value of a signature depends on these options."""

    keep: Annotated[tuple[Kept, ...], AfterValidator(_in_order)] = ("meshes",)
    """Parts of each surface that are stored beside the 28 kB of its spectrum. meshes: vertices and faces,
    149 kB for 10,000 faces, for pages, exports and other descriptors, with a thumbnail, 7 kB. overlaps: the
    integrals of products of squared eigenfunctions, 15 kB, for the descriptors wks and bihdm; they are
    computed from the mesh where they are not stored."""
