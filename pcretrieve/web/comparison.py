"""Two shapes side by side, and what differs; and shapes as places on a map."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor, TimeoutError as NotYet
from contextlib import suppress
from threading import Lock
from typing import Any

import numpy as np

from pcretrieve import Catalogue, PipelineOptions, SignatureIndex, TriangleMesh
from pcretrieve.draw.thumbnail import direction_upwards
from pcretrieve.errors import InputError, ShapeError
from pcretrieve.pages.html import without_folders
from pcretrieve.pages.map_page import map_drawing
from pcretrieve.pages.thumbnails import Thumbnails
from pcretrieve.values import FloatArray, unit_of
from pcretrieve.web.documents import record_of, shape_document
from pcretrieve.web.requests import Refused

# Largest number of faces that are sent to the viewer of a browser.
MOST_FACES = 20_000

# Largest number of shapes on a map: t-SNE takes about 15 s for so many, and more could not be told apart.
MOST_SHAPES = 2_000
SEED = 0

# Longest time for which a request waits for a map; seconds.
PATIENCE = 1.0


def compared(
    catalogue: Catalogue, pair: list[str], options: PipelineOptions, thumbnails: Thumbnails
) -> dict[str, Any]:
    """What the page of two shapes shows."""
    records = [record_of(catalogue, shape_id) for shape_id in pair]
    for record in records:
        if record.status != "done":
            raise InputError(
                f"{record.id} failed in the stage {record.stage}: it cannot be compared"
            )
    index = catalogue.index(options)
    distance = float(index.between(pair)[0, 1])
    score = None if index.scores is None else float(index.scores.of(np.array([distance]))[0])
    # Imported here, as below, so that the server starts sooner.
    from pcretrieve.pages.scene import measures

    rows: list[tuple[str, float, float]] = []
    with suppress(Refused):
        first, second = (measures(*_mesh_and_up(catalogue, name, thumbnails)) for name in pair)
        rows = [(name, first[name], second[name]) for name in first if name in second]
    return {
        "shapes": [shape_document(record) for record in records],
        "units": [unit_of(record.metres_per_unit or 0) or "" for record in records],
        "distance": distance,
        "measure": options.retrieval.distance,
        "score": score,
        "rows": rows,
    }


def scene_document(
    catalogue: Catalogue, shape_id: str, thumbnails: Thumbnails, other: str | None
) -> dict[str, Any]:
    """The surface of a shape for the viewer of a browser, coloured by where another one differs."""
    from pcretrieve.pages.scene import surface_scene

    mesh, up = _mesh_and_up(catalogue, shape_id, thumbnails)
    return surface_scene(
        mesh, up, None if other is None else _mesh_and_up(catalogue, other, thumbnails)[0]
    )


def _mesh_and_up(
    catalogue: Catalogue, shape_id: str, thumbnails: Thumbnails
) -> tuple[TriangleMesh, FloatArray | None]:
    """A surface, simplified if it has too many faces, and the direction that is up in its picture."""
    mesh, picture = (
        mesh_of(catalogue, shape_id),
        thumbnails.of(catalogue, record_of(catalogue, shape_id)),
    )
    if len(mesh.faces) > MOST_FACES:
        coarse = mesh.to_open3d().simplify_quadric_decimation(MOST_FACES)
        mesh = TriangleMesh(np.array(coarse.vertices), np.array(coarse.triangles, dtype=np.int32))
    return mesh, direction_upwards(picture or b"")


def mesh_of(catalogue: Catalogue, shape_id: str) -> TriangleMesh:
    """The surface of a shape."""
    record_of(catalogue, shape_id)
    try:
        return catalogue.mesh(shape_id)
    except (ShapeError, InputError):
        raise Refused(f"the surface of the shape {shape_id!r} is not stored") from None


class Maps:
    """The map that was computed last, beside the requests; any thread may ask for one."""

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="pcretrieve-map")
        self._lock = Lock()
        self._key: object = None
        self._places: Future[FloatArray] | None = None

    def shown(self, catalogue: Catalogue, options: PipelineOptions) -> dict[str, Any]:
        """What the page of the map shows, of a random sample if there are many shapes."""
        index = catalogue.index(options)
        rows = np.arange(len(index))
        if len(rows) > MOST_SHAPES:
            rows = np.sort(np.random.default_rng(SEED).choice(rows, MOST_SHAPES, replace=False))
        places = self._of(catalogue, index, rows)
        drawing, ids = None, [index.ids[row] for row in rows.tolist()]
        if places is not None:
            labels = catalogue.labels()
            drawing = map_drawing(ids, [labels.get(name) for name in ids], places)
        return {
            "drawing": drawing,
            "n_shown": len(ids),
            "n_shapes": len(index),
            "whitening": without_folders(index.whitening.reason),
        }

    def close(self) -> None:
        """End the thread."""
        self._thread.shutdown(cancel_futures=True)

    def _of(self, catalogue: Catalogue, index: SignatureIndex, rows: Any) -> FloatArray | None:
        """(n, 2) the places of rows of the index; None if they are not known yet."""
        key, revision = (tuple(index.ids), index.whitening.mean.tobytes()), catalogue.revision()
        with self._lock:
            if self._places is None or key != self._key:
                self._key = key
                self._places = self._thread.submit(
                    catalogue.cache.places, index.points[rows], revision
                )
            places = self._places
        try:
            return places.result(PATIENCE)
        except NotYet:
            return None
