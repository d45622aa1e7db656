"""Which descriptor the commands that compare shapes use."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pcretrieve.cli.parts import (
    say,
)

if TYPE_CHECKING:
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.options import SignatureOptions

__all__ = ["signature_options"]

# Bodies whose areas differ by more than this may be in different units: from a mouse to a horse it is less,
# from centimetres to metres more.
MIXED_UNITS = 3000


def signature_options(
    store: Catalogue,
    whitening: str,
    method: str | None,
    n_values: int | None,
    scale: str | None,
    size_weight: float | None,
) -> SignatureOptions:
    """The catalogue's own, with what the command line names in its place.

    By area is the better default but for PCA whitening, which takes the values relative in its place.
    """
    if scale is None and whitening == "pca" and store.options.signature.scale == "area":
        scale = "relative"
    given = {"method": method, "n_values": n_values, "scale": scale, "size_weight": size_weight}
    chosen = {name: value for name, value in given.items() if value is not None}
    options = store.options.changed(signature=chosen).signature
    if options.size_weight or options.scale == "absolute":
        _warn_of_mixed_units(store)
    return options


def _warn_of_mixed_units(store: Catalogue) -> None:
    areas = [record.area for record in store.records() if record.area]
    if areas and max(areas) > MIXED_UNITS * min(areas):
        say(
            f"the largest body in {store.path} has {max(areas) / min(areas):.0f} times the area of the "
            "smallest: size tells them apart only if all files have one unit"
        )
