"""Two shapes side by side, and what differs; and shapes as places on a map."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor, TimeoutError as NotYet
from contextlib import suppress
from functools import partial
from threading import Lock
from typing import Any

import numpy as np

from pcretrieve import (
    Catalogue,
    PipelineOptions,
    TriangleMesh,
    compare_measures,
    index,
    places,
)
from pcretrieve.errors import InputError, PcretrieveError, ShapeError
from pcretrieve.ingestion.pool import in_processes
from pcretrieve.pages.html import without_folders
from pcretrieve.pages.map_page import map_drawing
from pcretrieve.pages.thumbnails import Thumbnails
from pcretrieve.values import FloatArray
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
    catalogue: Catalogue,
    pair: list[str],
    options: PipelineOptions,
    thumbnails: Thumbnails,
) -> dict[str, Any]:
    """What the page of two shapes shows."""
    records = [record_of(catalogue, shape_id) for shape_id in pair]
    for record in records:
        if record.status != "done":
            raise InputError(
                f"{record.id} failed in the stage {record.stage}: it cannot be compared"
            )
    made = index(catalogue, options=options)
    distance = float(made.between(pair)[0, 1])
    score = (
        None if made.scores is None else float(made.scores.of(np.array([distance]))[0])
    )
    # Imported here, as below, so that the server starts sooner.
    from pcretrieve.pages.scene import measures

    measured: list[dict[str, float]] = []
    with suppress(Refused):
        measured = [measures(*_mesh_and_up(catalogue, name, thumbnails)) for name in pair]
    taped = compare_measures(catalogue, *pair) if measured else {}
    return {
        "shapes": [shape_document(record) for record in records],
        "units": [record.metres_per_unit for record in records],
        "distance": distance,
        "measure": options.retrieval.distance,
        "score": score,
        "measured": measured,
        "taped": taped,
    }


def scene_document(
    catalogue: Catalogue, shape_id: str, thumbnails: Thumbnails, other: str | None
) -> dict[str, Any]:
    """The surface of a shape for the viewer of a browser, coloured by where another one differs."""
    from pcretrieve.pages.scene import surface_scene

    mesh, up = _mesh_and_up(catalogue, shape_id, thumbnails)
    if other is None:
        return surface_scene(mesh, up)
    than, _ = _mesh_and_up(catalogue, other, thumbnails)
    own, its = (record_of(catalogue, one).metres_per_unit for one in (shape_id, other))
    # Without a common unit, bodies of one area are compared.
    factor = its / own if own and its else (mesh.area / than.area) ** 0.5
    return surface_scene(mesh, up, TriangleMesh(factor * than.vertices, than.faces))


def _mesh_and_up(
    catalogue: Catalogue, shape_id: str, thumbnails: Thumbnails
) -> tuple[TriangleMesh, FloatArray | None]:
    """A surface, simplified if it has too many faces, and the direction that is up in its picture."""
    mesh, record = mesh_of(catalogue, shape_id), record_of(catalogue, shape_id)
    if len(mesh.faces) > MOST_FACES:
        coarse = mesh.to_open3d().simplify_quadric_decimation(MOST_FACES)
        mesh = TriangleMesh(
            np.array(coarse.vertices), np.array(coarse.triangles, dtype=np.int32)
        )
    return mesh, thumbnails.direction(catalogue, record)


def mesh_of(catalogue: Catalogue, shape_id: str) -> TriangleMesh:
    """The surface of a shape."""
    record_of(catalogue, shape_id)
    try:
        return catalogue.mesh(shape_id)
    except (ShapeError, InputError):
        raise Refused(f"the surface of the shape {shape_id!r} is not stored") from None


def map_of(options: PipelineOptions, location: str) -> dict[str, Any]:
    """What the page of the map of a catalogue shows, of a random sample if there are many shapes."""
    with Catalogue(location) as catalogue:
        made = index(catalogue, options=options)
        rows = np.arange(len(made))
        if len(rows) > MOST_SHAPES:
            rows = np.sort(
                np.random.default_rng(SEED).choice(rows, MOST_SHAPES, replace=False)
            )
        ids = [made.ids[row] for row in rows.tolist()]
        drawn = places(catalogue, ids, options=options)
        return {
            "drawing": map_drawing(ids, catalogue, drawn),
            "n_shown": len(ids),
            "n_shapes": len(made),
            "whitening": without_folders(made.whitening.reason),
        }


class Maps:
    """The map that was computed last, by a process of its own; any thread may ask for one."""

    def __init__(self, location: str, options: PipelineOptions) -> None:
        self._location, self._function = location, partial(map_of, options)
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="pcretrieve-map")
        self._idle: list[Any] = []
        self._lock = Lock()
        self._revision = ""
        self._made: Future[dict[str, Any]] | None = None
        self._last: dict[str, Any] = {"drawing": None}

    def shown(self, catalogue: Catalogue) -> dict[str, Any]:
        """What the page of the map shows: an earlier map, if the present one takes long."""
        revision = catalogue.revision()
        with self._lock:
            # One at a time, because maps beside an ingest would never end otherwise.
            if self._made is None or (self._made.done() and revision != self._revision):
                self._revision, self._made = revision, self._thread.submit(self._computed)
            made = self._made
        try:
            with suppress(NotYet):
                self._last = made.result(PATIENCE)
        except PcretrieveError:
            self._revision = ""  # so that it is tried again
            raise
        return self._last

    def close(self) -> None:
        """End the thread and the process."""
        self._thread.shutdown(cancel_futures=True)
        for worker in self._idle:
            worker.stop()

    def _computed(self) -> dict[str, Any]:
        running = in_processes(
            self._function, [self._location], workers=1, idle=self._idle
        )
        ((_, outcome),) = running
        if isinstance(outcome, PcretrieveError):
            raise outcome
        return dict(outcome)
