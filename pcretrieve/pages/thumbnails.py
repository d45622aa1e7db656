"""Thumbnails of the shapes of a catalogue: those that it keeps, or drawn anew where bodies would lie."""

from __future__ import annotations

from collections import OrderedDict
from contextlib import suppress
from threading import Lock

import numpy as np

from pcretrieve import Catalogue, Record, TriangleMesh
from pcretrieve.draw.axes import AXES, body_axes, person_of, upward
from pcretrieve.draw.thumbnail import THUMBNAIL_PIXELS, direction_upwards, resized, thumbnail
from pcretrieve.errors import ShapeError
from pcretrieve.values import UPWARD, FloatArray

# Largest number of thumbnails in memory, of about 7 kB each.
MOST_KEPT = 5_000

# Number of thumbnails that show along which axis bodies stand. Largest distance of the direction upwards of a
# picture from an axis that was said, as pictures have four decimals, and from a guess: 10 degrees. Cosine
# of the angle from which the limbs of a person are believed, and not a guess.
N_ASKED = 200
SAID = 1e-3
GUESSED = 0.17
ASKEW = 0.6

# Least number of bodies that show along which axis all stand, and the largest angle between both.
FEWEST_BODIES = 10
NEAR_AXIS = np.radians(30)


class Thumbnails:
    """The thumbnails of one catalogue that were used last; any thread may ask for one.

    up: the axis that points upwards, which the catalogue keeps; by default that which it has, or shows.
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
            catalogue.keep_up(up)
        self._choose(catalogue, up or catalogue.up)

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
        catalogue.keep_up(up)
        with self._lock:
            self._kept.clear()
        self._choose(catalogue, up)

    def turn(self, catalogue: Catalogue, record: Record, *, forwards: bool) -> None:
        """Turn one shape by a quarter, to its side or forwards, if there is no axis for all."""
        picture, mesh = self.of(catalogue, record), catalogue.mesh(record.id)
        axes = body_axes(mesh.vertices, mesh.faces, direction_upwards(picture or b""))
        if turned := thumbnail(mesh.vertices, mesh.faces, up=axes[2 if forwards else 0]):
            catalogue.keep_thumbnail(record, turned)
        with self._lock:
            self._kept.pop((record.id, record.content_hash), None)

    def _choose(self, catalogue: Catalogue, said: str | None) -> None:
        self.said = said
        self.up = said or self._guessed(catalogue)

    def _picture(self, catalogue: Catalogue, record: Record) -> bytes | None:
        kept, up = catalogue.thumbnail(record.id), upward(self.up)
        drawn = None if kept is None else direction_upwards(kept)
        # Without a stored surface, the picture is left as it is.
        with suppress(ShapeError):
            if drawn is None or not self._is_right(drawn, up):
                mesh = catalogue.mesh(record.id)
                up = up if self.said else _or_its_own(mesh, up)
                if drawn is None or not self._is_right(drawn, up):
                    kept = thumbnail(mesh.vertices, mesh.faces, up=up)
                    # Not again after a failure, because a lock of another process is waited for.
                    if kept is not None and self._keeps:
                        self._keeps = catalogue.keep_thumbnail(record, kept)
        return kept and resized(kept, self._size)

    def _is_right(self, drawn: FloatArray, up: FloatArray | None) -> bool:
        return up is None or bool(np.linalg.norm(drawn - up) < (SAID if self.said else GUESSED))

    def _guessed(self, catalogue: Catalogue) -> str | None:
        records = next(catalogue.pages(status="done"), [])
        asked = records[:: -(-len(records) // N_ASKED) or 1]
        found = [direction_upwards(catalogue.thumbnail(one.id) or b"") for one in asked]
        return common_axis(np.reshape([one for one in found if one is not None], (-1, 3)))


def _or_its_own(mesh: TriangleMesh, up: FloatArray | None) -> FloatArray | None:
    """An axis that was guessed, unless the ground, or the limbs of a person, show another direction."""
    if mesh.up is not None:
        return mesh.up
    person = None if up is None else person_of(mesh.vertices, mesh.faces)
    own = up if person is None else person.upwards(mesh.vertices)
    return own if up is None or own is None or own @ up < ASKEW else up


def common_axis(directions: FloatArray) -> str | None:
    """The axis of files along which bodies stand: 4 of 10 or more, and three times as many as along others.

    The directions upwards that were found for them, (n, 3), are wrong for some, but not all along one axis.
    """
    along = (directions.reshape(-1, 3) @ AXES.T > np.cos(NEAR_AXIS)).sum(axis=0)
    second, first = np.sort(along)[-2:]
    if len(directions) < FEWEST_BODIES or first < 0.4 * len(directions) or first < 3 * second:
        return None
    return UPWARD[along.argmax()]
