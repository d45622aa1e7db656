"""Catalogue → a map of its shapes: `draw_map`."""

from __future__ import annotations

from pathlib import Path

from pcretrieve.catalogue import CatalogueLike, opened
from pcretrieve.options import OptionsLike, PipelineOptions
from pcretrieve.pages.map_page import write_map
from pcretrieve.query import without_labels

__all__ = ["draw_map"]


def draw_map(
    catalogue: CatalogueLike, path: str | Path, *, options: OptionsLike = None, up: str | None = None
) -> Path:
    """Draw the shapes of a catalogue in the plane, near shapes near each other.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The shapes.
    path : str or Path
        The file: a picture if it ends in ``.png``, by matplotlib (the extra ``plot``); a self-contained page
        if it ends in ``.html``, which shows name and thumbnail of a shape under the pointer.
    options : OptionsLike, optional
        Signature and whitening. By default the options of the catalogue; the whitening auto does not use
        labels.
    up : {"x", "-x", "y", "-y", "z", "-z"}, optional
        The axis of the files that points upwards on pictures; by default found for each shape.

    Returns
    -------
    Path
        Absolute path of the file.

    Raises
    ------
    CatalogueError
        If the options require other spectra than the catalogue has.
    InputError
        If the catalogue has no shapes, the file ends otherwise or cannot be written, or there is no
        matplotlib.
    """
    with opened(catalogue) as store:
        return write_map(store, path, without_labels(PipelineOptions.of(options, store.options)), up=up)
