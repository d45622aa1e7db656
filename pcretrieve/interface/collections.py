"""Catalogue → what its shapes are among each other: `duplicates`, `cluster` and `draw_map`."""

from __future__ import annotations

from pathlib import Path

from pcretrieve import searching
from pcretrieve.interface.catalogues import CatalogueLike, opened
from pcretrieve.options import OptionsLike, PipelineOptions
from pcretrieve.pages.map_page import write_map
from pcretrieve.retrieval import NearPair, cluster_numbers

__all__ = ["cluster", "draw_map", "duplicates"]


def duplicates(
    catalogue: CatalogueLike, *, options: OptionsLike = None, threshold: float | None = None
) -> list[NearPair]:
    """The pairs of shapes that are nearer than the noise, such as two scans of one body in one pose.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The shapes.
    options : OptionsLike, optional
        The signatures; with a `threshold` also the distance and the whitening. By default those of the
        catalogue.
    threshold : float, optional
        The largest distance of a pair. By default the root of the sum of squares of the uncertainties of both
        shapes, for the distance ``log`` without whitening; doubtful and unusable shapes are then left out.

    Returns
    -------
    list of NearPair
        Ids, distance and limit of each pair, nearest first.

    Raises
    ------
    CatalogueError
        If the options require other spectra than the catalogue has.
    InputError
        If the catalogue has no shapes; without `threshold`, if the signatures are not compared by logarithms.
    """
    with opened(catalogue) as store:
        chosen = PipelineOptions.of(options, store.options)
        return searching.duplicates(store, options=chosen, threshold=threshold)


def cluster(
    catalogue: CatalogueLike, *, options: OptionsLike = None, min_size: int = 3
) -> dict[str, str | None]:
    """Group the shapes of a catalogue without labels, by the density of their whitened signatures.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The shapes.
    options : OptionsLike, optional
        Signature and whitening. By default the options of the catalogue; the whitening auto does not use
        labels.
    min_size : int, default 3
        Least number of shapes of a cluster.

    Returns
    -------
    dict of str to (str or None)
        For each shape, in ascending order of id, ``cluster-1`` for the largest cluster, and so on; None for
        shapes in no cluster.

    Raises
    ------
    CatalogueError
        If the options require other spectra than the catalogue has.
    InputError
        If the catalogue has no shapes.
    OptionError
        If `min_size` is less than 2.
    """
    with opened(catalogue) as store:
        index = store.index(_without_labels(PipelineOptions.of(options, store.options)))
        numbers = cluster_numbers(index, min_size=min_size).tolist()
        return {
            shape_id: f"cluster-{number}" if number else None
            for shape_id, number in zip(index.ids, numbers, strict=True)
        }


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
        return write_map(store, path, _without_labels(PipelineOptions.of(options, store.options)), up=up)


def _without_labels(options: PipelineOptions) -> PipelineOptions:
    """The options, in which the whitening auto does not use labels, as in an evaluation."""
    if options.retrieval.calibration is None and options.retrieval.whitening == "auto":
        return options.changed(retrieval={"whitening": "neighbours"})
    return options
