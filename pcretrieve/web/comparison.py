"""Two shapes side by side, and what differs: size, spectra, signatures."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from pcretrieve.catalogue import Catalogue
from pcretrieve.errors import InputError, ShapeError
from pcretrieve.formats import mesh_bytes
from pcretrieve.options import PipelineOptions
from pcretrieve.pages.curves import Curves, curves
from pcretrieve.pages.html import page_template
from pcretrieve.pages.scene import surface_scene
from pcretrieve.pages.thumbnails import Thumbnails
from pcretrieve.surface.open3d import simplify
from pcretrieve.values import FloatArray, TriangleMesh
from pcretrieve.web.documents import shape_document
from pcretrieve.web.requests import NotFound

__all__ = ["compare_page", "glb_of", "scene_document"]

# Largest number of faces that are sent to the viewer of a browser.
MOST_FACES = 20_000


class _Row(NamedTuple):
    """A property of both shapes, as it is shown."""

    name: str
    first: str
    second: str


def compare_page(catalogue: Catalogue, title: str, a: str, b: str, options: PipelineOptions) -> str:
    """Two shapes in 3-D, which turn together, and what differs."""
    records = [catalogue.get(shape_id) for shape_id in (a, b)]
    for shape_id, record in zip((a, b), records, strict=True):
        if record is None:
            raise NotFound(f"there is no shape {shape_id!r}")
        if record.status != "done":
            raise InputError(f"{shape_id} failed in the stage {record.stage}: it cannot be compared")
    index = catalogue.index(options)
    distance = float(index.between([a, b])[0, 1])
    score = None if index.scores is None else float(index.scores.of(np.array([distance]))[0])
    first, second = (shape_document(record) for record in records if record is not None)
    return page_template("compare.html").render(
        title=title,
        shapes=(first, second),
        distance=distance,
        measure=options.retrieval.distance,
        score=score,
        rows=_rows(first, second),
        plots=_plots(catalogue, a, b),
    )


def scene_document(catalogue: Catalogue, shape_id: str, thumbnails: Thumbnails) -> dict[str, Any]:
    """The surface of a shape for the viewer of a browser, simplified if it has too many faces."""
    mesh = _mesh(catalogue, shape_id)
    up = thumbnails.up(catalogue, mesh)
    if len(mesh.faces) > MOST_FACES:
        mesh = TriangleMesh(*simplify(mesh.vertices, mesh.faces, n_faces=MOST_FACES))
    return surface_scene(mesh, up)


def glb_of(catalogue: Catalogue, shape_id: str) -> bytes:
    """The surface of a shape as a binary glTF file, in the unit of the scan."""
    return mesh_bytes(_mesh(catalogue, shape_id), "glb")


def _mesh(catalogue: Catalogue, shape_id: str) -> TriangleMesh:
    record = catalogue.get(shape_id)
    if record is None:
        raise NotFound(f"there is no shape {shape_id!r}")
    try:
        return catalogue.mesh(shape_id)
    except (ShapeError, InputError):
        raise NotFound(f"the surface of the shape {shape_id!r} is not stored") from None


def _rows(first: dict[str, Any], second: dict[str, Any]) -> list[_Row]:
    rows = []
    for name, key in (
        ("area", "area"),
        ("vertices", "n_vertices"),
        ("faces", "n_faces"),
        ("Euler characteristic", "euler"),
    ):
        shown = [f"{shape[key]:,.6g}" if shape[key] is not None else "unknown" for shape in (first, second)]
        rows.append(_Row(name, *shown))
    if first["area"] and second["area"]:
        ratio = (second["area"] / first["area"]) ** 0.5
        rows.append(_Row("size, the root of the area", "1", f"{ratio:.3f} times"))
    return rows


def _plots(catalogue: Catalogue, a: str, b: str) -> list[tuple[str, Curves]]:
    """Signatures and spectra of both shapes, as far as they are stored."""
    signatures = [catalogue.signature(shape_id) for shape_id in (a, b)]
    kind = "values"
    if all((values > 0).all() for values in signatures):
        kind, signatures = "logarithms of the values", [np.log(values) for values in signatures]
    plots = [(f"Signatures, {kind}", curves(signatures))]
    plots.append((f"Second signature minus the first, {kind}", curves([signatures[1] - signatures[0]])))
    spectra = [_spectrum(catalogue, shape_id) for shape_id in (a, b)]
    stored = [spectrum for spectrum in spectra if spectrum is not None and len(spectrum)]
    if len(stored) == len(spectra):
        plots.append(("Spectra at unit area, logarithms of the eigenvalues", curves(stored)))
    return plots


def _spectrum(catalogue: Catalogue, shape_id: str) -> FloatArray | None:
    """(n,) logarithms of the eigenvalues above zero of the surface at unit area, if they are stored."""
    try:
        spectrum = catalogue.shape(shape_id, needs=("spectrum",)).surfaces[0].spectrum
    except ShapeError:
        return None
    if spectrum is None:
        return None
    logs: FloatArray = np.log(spectrum.eigenvalues[spectrum.eigenvalues > 0])
    return logs
