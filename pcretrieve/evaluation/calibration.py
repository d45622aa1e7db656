"""Labelled catalogue → a whitening for other catalogues."""

from __future__ import annotations

from pathlib import Path

from pcretrieve.catalogue import Catalogue
from pcretrieve.options import PipelineOptions
from pcretrieve.retrieval import Whitening, write_whitening

__all__ = ["calibrate"]


def calibrate(catalogue: Catalogue, path: str | Path, options: PipelineOptions | None = None) -> Whitening:
    """Fit a within-class whitening to a labelled catalogue, and write it into a file.

    Parameters
    ----------
    catalogue : Catalogue
        Labelled shapes, such as three people in ten poses.
    path : str or Path
        The file, which `RetrievalOptions.calibration` names in searches of other catalogues.
    options : PipelineOptions, optional
        The signatures and the shrinkage; by default those of the catalogue.

    Returns
    -------
    Whitening
        The whitening.

    Raises
    ------
    CatalogueError
        If `options` require other spectra than the catalogue has.
    InputError
        If no class has two distinct shapes, or the file cannot be written.
    """
    options = options or catalogue.options
    fitted = catalogue.whitening(
        options.changed(retrieval={"whitening": "within-class", "calibration": None})
    )
    write_whitening(fitted, Path(path))
    return fitted
