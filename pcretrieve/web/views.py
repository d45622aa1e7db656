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
    """The shapes of the catalogue as thumbnails, with a form to search them by name and class."""
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
    """The shapes of the catalogue in the plane, similar ones near each other."""
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
    """A shape and its nearest neighbours; of a failed shape, why it failed."""
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
    """An uploaded scan: how far it is, why it failed, or its nearest neighbours."""
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
    """Why there is no page."""
    return page_template("refusal.html").render(title=title, message=message)
