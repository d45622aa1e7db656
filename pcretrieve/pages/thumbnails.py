"""Thumbnails of the shapes of a catalogue: those that it keeps, or drawn anew."""

from __future__ import annotations

from collections import OrderedDict
from threading import Lock

import numpy as np

from pcretrieve import Catalogue, Record, TriangleMesh
from pcretrieve.draw.axes import FEWEST_BODIES, NEAR_AXIS, common_axis, upward
from pcretrieve.draw.thumbnail import THUMBNAIL_PIXELS, direction_upwards, resized, thumbnail
from pcretrieve.errors import ShapeError
from pcretrieve.values import FloatArray

# Largest number of thumbnails in memory, of about 7 kB each.
MOST_KEPT = 5_000

# Number of thumbnails that show along which axis the bodies of a catalogue stand.
N_ASKED = 200


class Thumbnails:
    """The thumbnails of one catalogue that were used last; any thread may ask for one.

    size: side of the square pictures, at most 200; pixels.
    """

    def __init__(self, up: str | None = None, size: int = THUMBNAIL_PIXELS) -> None:
        self._given, self._size = upward(up), size
        self._common: FloatArray | None = None
        self._has_asked = False
        self._keeps = up is None
        self._kept: OrderedDict[tuple[str, str], bytes | None] = OrderedDict()
        self._lock = Lock()

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

    def up(self, catalogue: Catalogue, mesh: TriangleMesh) -> FloatArray | None:
        """(3,) the direction upwards of a surface, as given, known of the scan or common; None if unknown."""
        if self._given is not None:
            return self._given
        return self._common_axis(catalogue) if mesh.up is None else mesh.up

    def _picture(self, catalogue: Catalogue, record: Record) -> bytes | None:
        kept = None if self._given is not None else catalogue.thumbnail(record.id)
        drawn = None if kept is None else direction_upwards(kept)
        common = self._common_axis(catalogue)
        is_upright = drawn is not None and (common is None or drawn @ common > np.cos(NEAR_AXIS))
        if kept is not None and is_upright:
            return resized(kept, self._size)
        try:
            mesh = catalogue.mesh(record.id)
            if kept is not None and drawn is not None and mesh.up is not None:
                return resized(kept, self._size)
            picture = thumbnail(mesh.vertices, mesh.faces, up=self.up(catalogue, mesh))
        except ShapeError:
            return None
        # Not again after a failure, because a lock of another process is waited for.
        self._keeps = self._keeps and catalogue.keep_thumbnail(record, picture)
        return resized(picture, self._size)

    def _common_axis(self, catalogue: Catalogue) -> FloatArray | None:
        if self._given is None and not self._has_asked:
            records = next(catalogue.pages(status="done"), [])
            kept = [catalogue.thumbnail(one.id) for one in records[:: -(-len(records) // N_ASKED) or 1]]
            found = [direction_upwards(picture) for picture in kept if picture is not None]
            self._common = common_axis(np.reshape([one for one in found if one is not None], (-1, 3)))
            # Of fewer bodies the next answer may be another one.
            self._has_asked = len(records) >= FEWEST_BODIES
            if self._common is not None:
                with self._lock:
                    self._kept.clear()
        return self._common
