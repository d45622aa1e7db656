"""Labelled sets of meshes: a folder for each, with the meshes and their classes in ``labels.csv``."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from pcretrieve.benchmarks.progress import progress
from pcretrieve.catalogue import Catalogue
from pcretrieve.errors import BenchmarkError
from pcretrieve.formats import read_scan
from pcretrieve.ingestion.discover import discover
from pcretrieve.ingestion.labels import read_labels
from pcretrieve.ingestion.layouts import LAYOUTS
from pcretrieve.ingestion.run import Summary, ingest_files
from pcretrieve.options import PipelineOptions
from pcretrieve.simulation import POSES, body, make_subject
from pcretrieve.values import TriangleMesh

__all__ = ["SETS", "Item", "ingested", "left_out", "read_mesh", "spread"]

N_SUBJECTS = 10
HUMAN_POSES = (
    *("stand", "walk", "sit", "reach_up", "bow"),
    *("hands_on_hips", "hands_clasped", "legs_crossed", "crouch", "arms_crossed"),
)

Thing = TypeVar("Thing")


class Item(NamedTuple):
    """A clean mesh of a set.

    Attributes
    ----------
    number : int
        Position in the whole set, which seeds the random numbers of its scan.
    name : str
        Name of the mesh.
    label : str
        Class of the mesh.
    mesh : TriangleMesh
        The mesh.
    """

    number: int
    name: str
    label: str
    mesh: TriangleMesh


def left_out(part: str, folder: Path) -> str | None:
    """The line that is printed for a part of a benchmark if its set is missing.

    Parameters
    ----------
    part : str
        Name of the part.
    folder : Path
        The folder of the set.

    Returns
    -------
    str or None
        The line; None if the folder exists.
    """
    if folder.is_dir():
        return None
    layout = LAYOUTS.get(folder.name)
    published = f"; the set is published at {layout.published}" if layout is not None else ""
    return f"{part}: left out, {folder} is not there{published}"


def read_mesh(path: Path) -> TriangleMesh:
    """Read a mesh of a set.

    Parameters
    ----------
    path : Path
        A file of any format that `read_scan` reads.

    Returns
    -------
    TriangleMesh
        The mesh; unit of the file.

    Raises
    ------
    BenchmarkError
        If the file holds points without faces.
    ScanReadError
        If the file cannot be read.
    """
    mesh = read_scan(path)
    if not isinstance(mesh, TriangleMesh):
        raise BenchmarkError(f"{path} must hold a mesh, got points without faces")
    return mesh


@contextmanager
def ingested(
    folder: Path, path: Path, options: PipelineOptions, labels: dict[str, str] | None = None
) -> Iterator[tuple[Catalogue, Summary]]:
    """A new catalogue of all scans of a folder, open while the context lasts.

    Parameters
    ----------
    folder : Path
        The folder of the scans.
    path : Path
        The file of the catalogue.
    options : PipelineOptions
        Options of the catalogue.
    labels : dict of name to class, optional
        By default the classes in ``labels.csv`` in the folder.

    Yields
    ------
    Catalogue, Summary
        The catalogue, and the records of the ingest.
    """
    labels = read_labels(folder / "labels.csv") if labels is None else labels
    with Catalogue(path, options, create=True) as catalogue:
        yield catalogue, ingest_files(discover([folder]), catalogue, labels=labels)


def spread(things: Sequence[Thing], n: int | None) -> list[tuple[int, Thing]]:
    """Choose elements of a sequence at equal steps, from the first to the last.

    Parameters
    ----------
    things : sequence
        Any values.
    n : int or None
        Number of elements; None for all.

    Returns
    -------
    list of (int, object)
        Position and value of each chosen element.
    """
    n = len(things) if n is None else min(n, len(things))
    return [(k, things[k]) for k in np.linspace(0, len(things) - 1, n).round().astype(int).tolist()]


def _tosca(data: Path, limit: int | None) -> list[Item]:
    """The meshes of the set TOSCA."""
    labels = read_labels(data / "tosca" / "labels.csv")
    return [
        Item(number, path.stem, labels[path.name], read_mesh(path))
        for number, path in spread(discover([data / "tosca"]), limit)
    ]


def _humans(_: Path, limit: int | None) -> list[Item]:
    """Ten simulated people in ten poses; in half of the poses, parts of the body touch."""
    everybody = [(subject, pose) for subject in range(N_SUBJECTS) for pose in HUMAN_POSES]
    items = []
    for number, (subject, pose) in progress(spread(everybody, limit), "bodies"):
        individual = make_subject("person", np.random.default_rng(subject))
        mesh = body(individual, POSES["person"][pose], np.random.default_rng((subject, number)))
        items.append(Item(number, f"person{subject}_{pose}", f"person{subject}", mesh))
    return items


SETS: dict[str, Callable[[Path, int | None], list[Item]]] = {"tosca": _tosca, "humans": _humans}
"""Sets of clean meshes by name: functions of the folder of all sets and the number of meshes (None: all)."""
