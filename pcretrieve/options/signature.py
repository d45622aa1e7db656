"""The options of spectra and of signatures."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from pcretrieve.names import METHODS, NAMES, has_size, known_method
from pcretrieve.options.model import Count, Options

__all__ = ["Scale", "SignatureOptions", "SpectralOptions"]


class SpectralOptions(Options):
    """Surface of unit area → smallest eigenpairs of its Laplace–Beltrami operator."""

    element: Annotated[str, AfterValidator(NAMES["element"].known)] = "linear"
    """Discretisation of the operator. linear, cubic: finite elements on the triangles of the surface;
    intrinsic-delaunay: linear elements on the intrinsic Delaunay triangulation of the tufted cover, robust to
    badly shaped and non-manifold triangles; points: linear elements on local triangulations of the filtered
    points, without a surface."""
    n_pairs: Annotated[int, Field(ge=3)] = 61
    """Number of eigenpairs that are computed and stored, including the constant eigenfunction."""


Scale = Literal["relative", "area", "absolute"]


class SignatureOptions(Options):
    """Spectrum and surface → descriptor."""

    method: Annotated[str, AfterValidator(known_method)] = "combined"
    """The descriptor; `pcretrieve signature --help` lists all of them. Names joined by + fuse descriptors."""
    n_values: Count = 59
    """Number L of values of the descriptor; by default the most that R-BiHDM and Shape-DNA have with 61
    eigenpairs. For combined, of each of its two parts; for bags of features, the number of words."""
    n_modes: Annotated[int, Field(ge=2)] = 60
    """Number m of modes at which R-BiHDM, BiHDM, and the heat and wave kernels are truncated."""
    scale: Literal["auto", "relative", "area", "absolute"] = "auto"
    """Normalisation of the values: by the area of the surface (area), by the first value of the descriptor
    (relative, as in the papers), or none (absolute). area and relative are invariant to scaling; absolute
    compares sizes too, for files in one unit or whose units are all known. auto: relative if signatures are
    compared after PCA whitening, area otherwise, which for R-BiHDM gives the better rankings."""
    size_weight: Annotated[float, Field(ge=0, le=20)] = 0.0
    """Weight w of the size of a body relative to its form: area^w is appended to the values, if w > 0. In log
    distances, bodies whose areas differ by a factor of exp(1/w) are then 1 apart. For files in one unit or
    whose units are all known. Gives better rankings than the scale absolute."""

    @property
    def measured_by(self) -> Scale:
        """The normalisation of a signature by itself: `scale`, with area for auto."""
        return "area" if self.scale == "auto" else self.scale

    @property
    def compares_sizes(self) -> bool:
        """Whether signatures depend on the size of bodies, and so on the unit of the files."""
        return self.scale == "absolute" or self.size_weight > 0

    @model_validator(mode="after")
    def _has_a_size(self) -> SignatureOptions:
        if self.scale == "absolute" and not has_size(self.method):
            raise ValueError(
                f"scale: must be area or relative for {self.method}, which has no size to keep; absolute is "
                "for " + ", ".join(name for name, is_sized in METHODS.items() if is_sized)
            )
        return self
