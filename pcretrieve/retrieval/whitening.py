"""Whitening: an affine map of log-signatures after which all directions have the same variance.

`pcretrieve.retrieval.fitting` estimates the map from signatures, or takes the one of the changes that the
resolution of a surface causes.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import InputError, OptionError
from pcretrieve.options import WhiteningKind
from pcretrieve.values import FloatArray
from pcretrieve.values.base import Value, locked
from pcretrieve.values.files import write_file

#: What a whitening can be; "auto" stands for one of them.
WHITENINGS: tuple[str, ...] = tuple(kind for kind in get_args(WhiteningKind) if kind != "auto")

#: The kind of a whitening that was fitted to labelled shapes other than those that it is used for.
CALIBRATED = "calibrated"


@dataclass(frozen=True, slots=True, eq=False)
class Whitening(Value):
    """The map x → W (x − mean) of log-signatures.

    Attributes
    ----------
    kind : str
        One of `WHITENINGS`, or ``calibrated``.
    mean : (L,) float64
        Mean log-signature of the shapes of the fit; zero for ``none``.
    matrix : (L, L) float64
        W, symmetric positive definite, dimensionless; the identity for ``none``.
    n_fitted : int
        Number of shapes of the fit.
    shrinkage : float
        Regularisation as in `fit_whitening`; zero for ``none``.
    options_digest : str
        Digest of the signatures of the fit, to which alone the whitening may be applied.
    reason : str
        What was used and why, in one line.
    """

    kind: str
    mean: FloatArray
    matrix: FloatArray
    n_fitted: int
    shrinkage: float = 0.0
    options_digest: str = ""
    reason: str = ""

    def __post_init__(self) -> None:
        if self.kind not in (*WHITENINGS, CALIBRATED):
            raise OptionError(f"whitening must be one of {', '.join(WHITENINGS)}, got {self.kind!r}")
        mean = locked("the mean of a whitening", self.mean, (None,))
        matrix = locked("the matrix of a whitening", self.matrix, (len(mean), len(mean)))
        object.__setattr__(self, "mean", mean)
        object.__setattr__(self, "matrix", matrix)

    def check_made_for(self, digest: str) -> None:
        """InputError if the whitening was fitted on signatures of another digest."""
        if self.options_digest != digest:
            raise InputError(
                f"the whitening must be fitted on signatures made by the same options as the table "
                f"({digest!r}), got {self.options_digest!r}; fit it again"
            )

    def apply(self, logs: FloatArray) -> FloatArray:
        """Whitened log-signatures.

        Parameters
        ----------
        logs : (N, L) float64
            Log-signatures, one in each row.

        Returns
        -------
        (N, L) float64
            W (x − mean) for each row x; the input array itself for ``none``.

        Raises
        ------
        InputError
            If the log-signatures do not have L values.
        """
        if logs.ndim != 2 or logs.shape[1] != len(self.mean):
            raise InputError(
                f"log-signatures must have shape (N, {len(self.mean)}), as this whitening was fitted, "
                f"got {logs.shape}"
            )
        if self.kind == "none":
            return logs
        # einsum instead of a BLAS product, in which the rounding of a row depends on the other rows: equal
        # signatures would no longer be at exactly equal distances.
        whitened: FloatArray = np.einsum("ij,kj->ik", logs - self.mean, self.matrix)
        return whitened

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """The attributes as arrays by name, none of which needs pickle."""
        return {field.name: np.asarray(getattr(self, field.name)) for field in fields(self)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Whitening:
        """The inverse of `to_arrays`; InputError if an array is missing or has the wrong shape."""
        missing = [name for name in cls.__slots__ if name not in arrays]
        if missing:
            raise InputError(
                f"a stored whitening must hold {', '.join(cls.__slots__)}; missing: {', '.join(missing)}; "
                "fit it again"
            )
        return cls(
            kind=str(arrays["kind"]),
            mean=arrays["mean"],
            matrix=arrays["matrix"],
            n_fitted=int(arrays["n_fitted"]),
            shrinkage=float(arrays["shrinkage"]),
            options_digest=str(arrays["options_digest"]),
            reason=str(arrays["reason"]),
        )


def write_whitening(whitening: Whitening, path: Path) -> None:
    """Write a whitening that was fitted to labelled shapes, for shapes of other catalogues."""
    arrays = whitening.to_arrays() | {"kind": np.array(CALIBRATED)}
    packed = io.BytesIO()
    np.savez(packed, allow_pickle=False, **arrays)
    write_file(path, packed.getvalue())


def read_whitening(path: Path) -> Whitening:
    """Read a whitening of `write_whitening`."""
    try:
        # NumPy leaves a file open that is no archive.
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            whitening = Whitening.from_arrays(arrays)
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, AttributeError, TypeError) as error:
        raise InputError(
            f"a whitening must be a name such as auto, or a file of `pcretrieve calibrate`, got {path} "
            f"({error})"
        ) from error
    return replace(whitening, reason=f"{whitening.reason}, from {path}")
