"""One scan, inspected: its findings, and a page of them."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path

from pcretrieve.catalogue import CatalogueLike, opened
from pcretrieve.checks import Inspection
from pcretrieve.formats import ScanLike
from pcretrieve.options import OptionsLike
from pcretrieve.pages.inspection_page import write_inspection_page
from pcretrieve.pipeline.inspecting import inspect_scan


def inspect(
    scan: ScanLike,
    options: OptionsLike = None,
    *,
    n_rescans: int = 4,
    page: str | Path | None = None,
    catalogue: CatalogueLike | None = None,
) -> Inspection:
    """Process a scan, and check the result of each stage.

    Parameters
    ----------
    scan : ScanLike
        A path, an array or geometry.
    options : OptionsLike, optional
        Options, a preset's name, a TOML file, or a mapping.
    n_rescans : int, default 4
        Number of surfaces that are reconstructed from nine tenths of the points, for the rescan deviation of
        the signature; 0 for none.
    page : str or Path, optional
        An HTML file to which a page with the results is written.
    catalogue : Catalogue, str or Path, optional
        Where the next body is looked for, with whose distance the error bar of the signature is compared; its
        options are then the defaults. Without a catalogue, this distance is that of people.

    Returns
    -------
    Inspection
        Points, normals, surface, checks and signature; those of the earlier stages if a stage fails.

    Raises
    ------
    InputError
        If `scan` cannot be converted to a cloud or a mesh, or the page cannot be written.
    CatalogueError
        If the options require other spectra than the catalogue has.
    """
    with nullcontext() if catalogue is None else opened(catalogue) as store:
        found = inspect_scan(scan, options, n_rescans=n_rescans, catalogue=store)
    if page is not None:
        write_inspection_page(found, page)
    return found
