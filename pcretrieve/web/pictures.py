"""Thumbnails of shapes, drawn when they are first asked for."""

from __future__ import annotations

from collections import OrderedDict
from threading import Lock

from pcretrieve.catalogue import Catalogue
from pcretrieve.errors import ShapeError
from pcretrieve.rendering import thumbnail
from pcretrieve.types import FloatArray
from pcretrieve.web.requests import NotFound

__all__ = ["Thumbnails"]

# Largest number of thumbnails in memory, of about 6 kB each.
MOST_KEPT = 5_000

PIXELS = 200


class Thumbnails:
    """The thumbnails that were drawn last; any thread may ask for one.

    Parameters
    ----------
    up : (3,) float64, optional
        The direction upwards of all shapes; by default found for each of them.
    """

    def __init__(self, up: FloatArray | None = None) -> None:
        self._up = up
        self._kept: OrderedDict[tuple[str, str], bytes | None] = OrderedDict()
        self._lock = Lock()

    def of(self, catalogue: Catalogue, shape_id: str) -> bytes:
        """The thumbnail of a shape.

        Parameters
        ----------
        catalogue : Catalogue
            The catalogue.
        shape_id : str
            The id of a shape.

        Returns
        -------
        bytes
            A PNG file.

        Raises
        ------
        NotFound
            If there is no such shape, its mesh is not stored, or cannot be drawn.
        """
        record = catalogue.get(shape_id)
        if record is None:
            raise NotFound(f"there is no shape {shape_id!r}")
        key = shape_id, record.content_hash
        with self._lock:
            known = key in self._kept
            picture = self._kept.get(key)
            if known:
                self._kept.move_to_end(key)
        if not known:
            picture = _drawn(catalogue, shape_id, self._up) if record.status == "done" else None
            with self._lock:
                self._kept[key] = picture
                if len(self._kept) > MOST_KEPT:
                    self._kept.popitem(last=False)
        if picture is None:
            raise NotFound(f"the shape {shape_id!r} has no picture, because its mesh is not stored")
        return picture


def _drawn(catalogue: Catalogue, shape_id: str, up: FloatArray | None) -> bytes | None:
    try:
        mesh = catalogue.mesh(shape_id)
        return thumbnail(mesh.vertices, mesh.faces, up=mesh.up if up is None else up, size=PIXELS)
    except ShapeError:
        return None
