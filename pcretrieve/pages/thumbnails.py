"""Thumbnails of the shapes of a catalogue: those that it keeps, or drawn again where an axis is up."""

from __future__ import annotations

from collections import OrderedDict
from contextlib import suppress
from threading import Lock

import numpy as np

from pcretrieve import Catalogue, Record, ShapeError
from pcretrieve.draw.axes import body_axes, upward
from pcretrieve.draw.pictures import THUMBNAIL_PIXELS, resized
from pcretrieve.values import FloatArray

# Largest number of thumbnails in memory, of about 7 kB each.
MOST_KEPT = 5_000


class Thumbnails:
    """The thumbnails of one catalogue that were used last; any thread may ask for one.

    up: the axis that points upwards, which the catalogue keeps; by default the one that it has, if any.
    size: side of the square pictures, at most 200; pixels.
    """

    def __init__(
        self, catalogue: Catalogue, up: str | None = None, size: int = THUMBNAIL_PIXELS
    ) -> None:
        upward(up)  # raises
        self._size, self._lock = size, Lock()
        self._kept: OrderedDict[tuple[str, str], bytes | None] = OrderedDict()
        self._keeps = True
        if up is not None:
            catalogue.rows.keep_up(up)
        self.up = up or catalogue.rows.settings().get("up")

    def of(self, catalogue: Catalogue, record: Record) -> bytes | None:
        """The thumbnail of a shape."""
        key = record.id, record.content_hash
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        picture = self._picture(catalogue, record) if record.status == "done" else None
        with self._lock:
            self._kept[key] = picture
            if len(self._kept) > MOST_KEPT:
                self._kept.popitem(last=False)
        return picture

    def say(self, catalogue: Catalogue, up: str | None) -> None:
        """Turn all shapes, so that an axis points upwards, or with None as they show."""
        upward(up)
        catalogue.rows.keep_up(up)
        with self._lock:
            self._kept.clear()
        self.up = up

    def turn(self, catalogue: Catalogue, record: Record, *, forwards: bool) -> None:
        """Turn one shape by a quarter, to its side or forwards, if there is no axis for all."""
        mesh = catalogue.mesh(record.id)
        axes = body_axes(mesh.vertices, mesh.faces, self.direction(catalogue, record))
        if turned := mesh.thumbnail(axes[2 if forwards else 0]):
            catalogue.rows.keep_thumbnail(record, *turned)
        with self._lock:
            self._kept.pop((record.id, record.content_hash), None)

    def direction(self, catalogue: Catalogue, record: Record) -> FloatArray | None:
        """(3,) the direction upwards in the thumbnail of a shape."""
        return upward(self.up) if self.up else catalogue.rows.direction_upwards(record.id)

    def _picture(self, catalogue: Catalogue, record: Record) -> bytes | None:
        kept, up = catalogue.thumbnail(record.id), upward(self.up)
        # Without a stored surface, the picture is left as it is.
        with suppress(ShapeError):
            if kept is None or (
                up is not None and not self._shows(catalogue, record, up)
            ):
                drawn = catalogue.mesh(record.id).thumbnail(up)
                # Not again after a failure, because a lock of another process is waited for.
                if drawn is not None and self._keeps:
                    self._keeps = catalogue.rows.keep_thumbnail(record, *drawn)
                kept = None if drawn is None else drawn.png
        return kept and resized(kept, self._size)

    def _shows(self, catalogue: Catalogue, record: Record, up: FloatArray) -> bool:
        """Whether a direction is upwards in the stored picture."""
        drawn = catalogue.rows.direction_upwards(record.id)
        return drawn is not None and np.allclose(drawn, up)
