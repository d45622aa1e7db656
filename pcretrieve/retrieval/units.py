"""The unit in which the sizes of bodies are compared."""

from __future__ import annotations

from pcretrieve.errors import InputError
from pcretrieve.values import SizeUnit

__all__ = ["check_unit"]

INSTEAD = "or compare the form alone (size_weight = 0, and the scale area)"


def check_unit(unit: SizeUnit | None, gallery: SizeUnit | None) -> None:
    """Check that the size of a query is in the unit of the sizes of a gallery.

    Nothing is converted here, because scans whose unit is known are converted to metres when they are read.

    unit: `Signature.unit` of the query.
    gallery: `SignatureTable.unit` of the gallery.
    """
    if (unit, gallery) == ("unknown", "m"):
        raise InputError(
            "sizes must be in one unit to be compared: the shapes are in metres, the unit of the query is "
            f"unknown; say the unit of the query by --unit (scan.unit), {INSTEAD}"
        )
    if (unit, gallery) == ("m", "unknown"):
        raise InputError(
            "sizes must be in one unit to be compared: the query is in metres, the unit of the shapes is "
            f"unknown; ingest the shapes into a new catalogue with --unit (scan.unit), {INSTEAD}"
        )
