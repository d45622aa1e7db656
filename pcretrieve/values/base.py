"""The base class of all immutable values: read-only arrays, equality by value, pickling; units of length."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pcretrieve.errors import InputError

#: Name of the length of the unit, in metres, among the sizes of the step ``read`` of the provenance. It is 1
#: for all scans whose unit is known, because they are converted to metres when they are read.
UNIT = "metres_per_unit"

# The notes on a file for which another unit was given than it has, or than files of its format usually have.
UNIT_KEPT = "is not applied, because the file names its unit"
UNIT_TAKEN = "is applied, though such files usually have"

#: Metres of each unit of length, by its symbol.
METRES = {
    "um": 1e-6,
    "mm": 1e-3,
    "cm": 1e-2,
    "dm": 1e-1,
    "m": 1.0,
    "km": 1e3,
    "in": 0.0254,
    "ft": 0.3048,
}

# Ratios of sizes that a wrong unit explains: of metres to decimetres, centimetres and millimetres, and of
# inches to millimetres and to metres. Bodies may differ by a third beside.
WRONG_UNITS = (10.0, 25.4, 39.37, 100.0, 1000.0)
ALIKE = 1.33

#: Unit of length of the sizes in signatures: metres, or the unit of a file whose format does not have one.
SizeUnit = Literal["m", "unknown"]


class Value:
    """Base class of the immutable values, which are dataclasses with ``eq=False``.

    Two values of one class are equal if their compared fields are equal, arrays element by element. A value
    is pickled by its constructor arguments, so that the arrays of copies are checked and read-only too.
    """

    __slots__ = ()

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        compared = [part.name for part in fields(self) if part.compare]  # type: ignore[arg-type]
        return all(_equal(getattr(self, name), getattr(other, name)) for name in compared)

    # Arrays have no hash, and one of the other fields alone would be misleading.
    __hash__ = None  # type: ignore[assignment]

    def _lock(
        self,
        name: str,
        shape: tuple[int | None, ...],
        dtype: type[np.generic] = np.float64,
        *,
        finite: bool = True,
    ) -> NDArray[Any]:
        """Replace the array of a field by its `locked` copy, and return that."""
        array = locked(name, getattr(self, name), shape, dtype, finite=finite)
        object.__setattr__(self, name, array)
        return array

    def __reduce__(self) -> tuple[type, tuple[Any, ...]]:
        return type(self), tuple(getattr(self, part.name) for part in fields(self))  # type: ignore[arg-type]


def unit_note(ratio: float, unit: str) -> str:
    """What to say of a scan that is so many times as large as others, if a wrong unit explains it.

    unit: the unit that its lengths were taken for, or ``none``.
    """
    larger = max(ratio, 1 / ratio)
    near = min(WRONG_UNITS, key=lambda one: abs(math.log(larger / one)))
    if max(larger / near, near / larger) > ALIKE:
        return ""
    right = METRES.get(unit, 1.0) * larger / near / ratio
    meant = [
        one
        for one in ("m", "dm", "cm", "mm", "in")
        if math.isclose(METRES[one], right, rel_tol=0.01)
    ]
    advice = (
        f"if its unit is {meant[0]}, give --unit {meant[0]}"
        if meant
        else "give each file its unit by --unit"
    )
    return f"about {near:,.4g} times as {'large' if ratio > 1 else 'small'} as the others; {advice}"


def check_type(name: str, value: object, *kinds: type) -> None:
    """InputError if an argument is of none of some types."""
    if not isinstance(value, kinds):
        wanted = " or ".join(kind.__name__ for kind in kinds)
        raise InputError(
            f"{name} must be of the type {wanted}, got {type(value).__name__}"
        )


def _equal(one: Any, other: Any) -> bool:
    if type(one) is not type(other):
        return False
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other)
    if hasattr(one, "nnz"):  # sparse
        return bool(one.shape == other.shape and (one != other).nnz == 0)
    return bool(one == other)


def numbers(name: str, values: ArrayLike) -> NDArray[Any]:
    """Real numbers as an array of any shape and type."""
    try:
        array = np.asarray(values)
    except ValueError as error:  # rows of different lengths
        raise InputError(f"{name} must be an array of numbers: {error}") from error
    if array.dtype.kind not in "iuf":
        raise InputError(
            f"{name} must be an array of numbers, got one of type {array.dtype}"
        )
    return array


def locked(
    name: str,
    values: ArrayLike,
    shape: tuple[int | None, ...],
    dtype: type[np.generic] = np.float64,
    *,
    finite: bool = True,
) -> NDArray[Any]:
    """A read-only copy of an array, after a check of its shape and its values."""
    given = numbers(name, values)
    wanted = (
        "(" + ", ".join("n" if length is None else str(length) for length in shape) + ")"
    )
    if given.ndim != len(shape) or any(
        length not in (None, found)
        for length, found in zip(shape, given.shape, strict=True)
    ):
        raise InputError(f"{name} must have shape {wanted}, got {given.shape}")
    bad = ~np.isfinite(given) if finite else np.isnan(given)
    if bad.any():
        kinds = "NaN or infinite" if finite else "NaN"
        wanted = "finite" if finite else "numbers"
        raise InputError(
            f"{name} must be {wanted}, got {bad.sum()} values that are {kinds}"
        )
    with np.errstate(invalid="ignore", over="ignore"):  # overflow is detected below
        array = np.array(given, dtype=dtype, order="C")
    if np.issubdtype(dtype, np.integer) and (array != given).any():
        n_bad = int((array != given).sum())
        raise InputError(
            f"{name} must be whole numbers below 2³¹, got {n_bad} that are not"
        )
    array.flags.writeable = False
    return array


def unit_of(metres: float) -> str | None:
    """The symbol, a key of `METRES`, of the unit of this length, to six digits; None if there is none."""
    return next(
        (
            unit
            for unit, length in METRES.items()
            if math.isclose(length, metres, rel_tol=1e-6)
        ),
        None,
    )
