"""Thumbnails of the shapes of a catalogue: those that it keeps, or drawn anew."""

from __future__ import annotations

from collections import OrderedDict
from threading import Lock

from pcretrieve.catalogue import Catalogue, Record
from pcretrieve.errors import ShapeError
from pcretrieve.rendering import THUMBNAIL_PIXELS, is_current, resized, thumbnail, upward

__all__ = ["Thumbnails"]

# Largest number of thumbnails in memory, of about 7 kB each.
MOST_KEPT = 5_000


class Thumbnails:
    """The thumbnails that were used last; any thread may ask for one.

    Parameters
    ----------
    up : {"x", "-x", "y", "-y", "z", "-z"}, optional
        The axis of the files that points upwards; bodies are then drawn anew. By default the direction is
        found for each surface, and the thumbnails that were stored with the shapes are used.
    size : int, default 200
        Side of the square pictures, at most 200; pixels.

    Raises
    ------
    OptionError
        If `up` is no axis.
    """

    def __init__(self, up: str | None = None, size: int = THUMBNAIL_PIXELS) -> None:
        self._up, self._size = upward(up), size
        self._kept: OrderedDict[tuple[str, str], bytes | None] = OrderedDict()
        self._lock = Lock()

    def of(self, catalogue: Catalogue, record: Record) -> bytes | None:
        """The thumbnail of a shape.

        Parameters
        ----------
        catalogue : Catalogue
            The catalogue.
        record : Record
            The record of a shape.

        Returns
        -------
        bytes or None
            A PNG file; None if the shape failed, its mesh is not stored, or cannot be drawn.
        """
        key = record.id, record.content_hash
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        picture = self._picture(catalogue, record.id) if record.status == "done" else None
        with self._lock:
            self._kept[key] = picture
            if len(self._kept) > MOST_KEPT:
                self._kept.popitem(last=False)
        return picture

    def _picture(self, catalogue: Catalogue, shape_id: str) -> bytes | None:
        kept = None if self._up is not None else catalogue.thumbnail(shape_id)
        if kept is not None and is_current(kept):
            return resized(kept, self._size)
        try:
            mesh = catalogue.mesh(shape_id)
            up = mesh.up if self._up is None else self._up
            return thumbnail(mesh.vertices, mesh.faces, up=up, size=self._size)
        except ShapeError:
            return None
