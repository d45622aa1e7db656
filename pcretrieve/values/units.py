"""Units of length."""

from __future__ import annotations

import math
from typing import Literal

#: Name of the length of the unit, in metres, among the sizes of the step ``read`` of the provenance. It is 1
#: for all scans whose unit is known, because they are converted to metres when they are read.
UNIT = "metres_per_unit"

#: Metres of each unit of length, by its symbol.
METRES = {"um": 1e-6, "mm": 1e-3, "cm": 1e-2, "dm": 1e-1, "m": 1.0, "km": 1e3, "in": 0.0254, "ft": 0.3048}

#: Unit of length of the sizes in signatures: metres, or the unit of a file whose format does not have one.
SizeUnit = Literal["m", "unknown"]


def unit_of(metres: float) -> str | None:
    """The unit of a length.

    metres: length of the unit; metres.
    Returns str or None: the symbol, a key of `METRES`; None if no unit has this length, to six digits.
    """
    return next((unit for unit, length in METRES.items() if math.isclose(length, metres, rel_tol=1e-6)), None)
