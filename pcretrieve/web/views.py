"""Pages of the search server: the collection, and a shape with its neighbours."""

from __future__ import annotations

from typing import Any

from pcretrieve.catalogue import Catalogue
from pcretrieve.options import PipelineOptions
from pcretrieve.pages.html import page_template
from pcretrieve.pages.map_page import class_groups, map_drawing
from pcretrieve.web.documents import (
    listing_document,
    shape_document,
    similar_document,
    similar_to,
)
from pcretrieve.web.folders import without_folders
from pcretrieve.web.listing import class_names
from pcretrieve.web.maps import Maps
from pcretrieve.web.requests import Listing, NotFound, Similar
from pcretrieve.web.uploads import upload_suffixes

__all__ = ["collection_page", "map_page", "refusal_page", "scan_page", "shape_page"]


def collection_page(
    catalogue: Catalogue, title: str, listing: Listing, most_bytes: int, *, keeps_scans: bool
) -> str:
    """The shapes of the catalogue as thumbnails, with a form to search them by name and class.

    Parameters
    ----------
    catalogue : Catalogue
        The shapes.
    title : str
        Name of the collection.
    listing : Listing
        Which shapes are shown.
    most_bytes : int
        Largest size of a scan that may be uploaded; 0 if none may.
    keeps_scans : bool
        Whether an uploaded scan can be stored in the catalogue.

    Returns
    -------
    str
        The page.
    """
    return page_template("collection.html").render(
        title=title,
        listing=listing,
        found=listing_document(catalogue, listing),
        classes=class_names(catalogue),
        suffixes=upload_suffixes() if most_bytes else (),
        most_bytes=most_bytes,
        keeps_scans=keeps_scans,
    )


def map_page(catalogue: Catalogue, title: str, maps: Maps, options: PipelineOptions) -> str:
    """The shapes of the catalogue in the plane, similar ones near each other.

    Parameters
    ----------
    catalogue : Catalogue
        The shapes.
    title : str
        Name of the collection.
    maps : Maps
        Where the places are kept.
    options : PipelineOptions
        How shapes are compared.

    Returns
    -------
    str
        The page; as long as the places are computed, one that loads itself again.
    """
    index = catalogue.index(options)
    layout = maps.of(index)
    drawing, ids = None, []
    if layout is not None:
        ids = [index.ids[row] for row in layout.rows.tolist()]
        labels = {origin.id: origin.label for origin in catalogue.origins()}
        drawing = map_drawing(ids, class_groups([labels.get(name) for name in ids]), layout.places)
    return page_template("search_map.html").render(
        title=title,
        drawing=drawing,
        n_shown=len(ids),
        n_shapes=len(index),
        whitening=without_folders(index.whitening.reason),
    )


def shape_page(
    catalogue: Catalogue, title: str, shape_id: str, asked: Similar, options: PipelineOptions
) -> str:
    """A shape and its nearest neighbours; of a failed shape, why it failed.

    Parameters
    ----------
    catalogue : Catalogue
        The catalogue.
    title : str
        Name of the collection.
    shape_id : str
        The id of the shape.
    asked : Similar
        What is asked of the neighbours.
    options : PipelineOptions
        How shapes are compared.

    Returns
    -------
    str
        The page.

    Raises
    ------
    NotFound
        If there is no such shape.
    """
    record = catalogue.get(shape_id)
    if record is None:
        raise NotFound(f"there is no shape {shape_id!r}")
    found = None
    if record.status == "done":
        answer = similar_to(catalogue, shape_id, asked, options)
        found = similar_document(catalogue, shape_id, asked, options, answer)
    return page_template("shape.html").render(
        title=title,
        shape=shape_document(record),
        asked=asked,
        found=found,
        classes=class_names(catalogue),
    )


def scan_page(
    catalogue: Catalogue,
    title: str,
    job: dict[str, Any],
    asked: Similar,
    found: dict[str, Any] | None,
    *,
    has_picture: bool,
    can_be_kept: bool,
) -> str:
    """An uploaded scan: how far it is, why it failed, or its nearest neighbours.

    Parameters
    ----------
    catalogue : Catalogue
        The catalogue.
    title : str
        Name of the collection.
    job : dict
        The document of the job.
    asked : Similar
        What is asked of the neighbours.
    found : dict or None
        The document of the answer; None while there is none.
    has_picture : bool
        Whether there is a picture of the scan.
    can_be_kept : bool
        Whether the scan can be stored in the catalogue.

    Returns
    -------
    str
        The page.
    """
    return page_template("scan.html").render(
        title=title,
        job=job,
        asked=asked,
        found=found,
        classes=class_names(catalogue),
        has_picture=has_picture,
        can_be_kept=can_be_kept,
    )


def refusal_page(title: str, message: str) -> str:
    """Why there is no page.

    Parameters
    ----------
    title : str
        Name of the collection.
    message : str
        What does not hold, and what to do.

    Returns
    -------
    str
        The page.
    """
    return page_template("refusal.html").render(title=title, message=message)
