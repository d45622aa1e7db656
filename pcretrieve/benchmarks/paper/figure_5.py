"""Figure 5 as retrieval: meshes with noise and with holes as queries, other clean meshes as the gallery."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from pcretrieve.benchmarks.paper.section_4_4 import NOISE, REMOVED, noisy, without_faces
from pcretrieve.benchmarks.paper.spectra import unit_area_spectrum
from pcretrieve.benchmarks.progress import progress
from pcretrieve.benchmarks.sets import read_mesh, spread
from pcretrieve.descriptors import describe
from pcretrieve.errors import PcretrieveError
from pcretrieve.evaluation import evaluate_rankings
from pcretrieve.evaluation.rankings import rank_gallery
from pcretrieve.ingestion.discover import discover
from pcretrieve.ingestion.isolation import in_processes
from pcretrieve.ingestion.labels import read_labels
from pcretrieve.options import Scale, SignatureOptions
from pcretrieve.retrieval import DistanceBlock
from pcretrieve.retrieval.distances import log_signatures, pairwise
from pcretrieve.values import FloatArray, Shape, Surface

__all__ = ["figure_5"]

N_MODES = 60
N_VALUES = 23

PERTURBATIONS = (*(f"noise {size}" for size in NOISE), *(f"holes {share:.0%}" for share in REMOVED))

VARIANTS: tuple[tuple[str, Scale], ...] = (
    ("r-bihdm", "relative"),
    ("r-bihdm", "area"),
    ("shape-dna", "relative"),
    ("wks", "relative"),
    ("csd", "relative"),
    ("combined", "relative"),
    ("combined", "area"),
)

OPTIONS = tuple(
    SignatureOptions(method=method, n_values=N_VALUES, n_modes=N_MODES, scale=scale)
    for method, scale in VARIANTS
)

# Longest time for one mesh; seconds.
TIMEOUT = 300.0


def figure_5(folder: Path, limit: int | None) -> Iterator[str]:
    """NN and mAP of perturbed queries, for each descriptor.

    Parameters
    ----------
    folder : Path
        A set of meshes with their classes in ``labels.csv``.
    limit : int or None
        Number of meshes, evenly spread over the set; None for all.

    Yields
    ------
    str
        A line of the table.

    Raises
    ------
    PcretrieveError
        If a mesh has no spectrum.
    """
    paths = [path for _, path in spread(discover([folder]), limit)]
    found = _signatures(paths)
    classes = read_labels(folder / "labels.csv")
    labels = [classes[path.name] for path in paths]
    yield (
        f"Figure 5: {len(paths)} meshes of {folder.name}, each perturbed, as queries, and the others, clean, "
        "as the gallery"
    )
    yield f"NN and mAP, distance log, L = {N_VALUES}; noise in mean edge lengths, holes in shares of faces"
    names = ("clean", *PERTURBATIONS)
    yield f"{'method':<12}{'scale':<10}" + "".join(f"{name:<12}" for name in names).rstrip()
    for row, (method, scale) in enumerate(VARIANTS):
        tables = np.stack([one[row] for one in found], axis=1)  # (1 + P, N, L)
        cells = []
        for table in tables:
            # A ranking leaves out the query, here its own clean mesh.
            block = DistanceBlock(np.arange(len(paths)), pairwise("log", table, tables[0]))
            measured = evaluate_rankings(rank_gallery((block,), [path.stem for path in paths], labels))
            cells.append(f"{measured.nn:.2f} {measured.map:.2f}")
        yield f"{method:<12}{scale:<10}" + "".join(f"{cell:<12}" for cell in cells).rstrip()


def _signatures(paths: Sequence[Path]) -> list[list[FloatArray]]:
    """The log-signatures of each mesh, as by `_perturbed`."""
    tasks = list(enumerate(paths))
    outcomes = dict(
        in_processes(_perturbed, progress(tasks, "perturbed"), workers=None, timeout=TIMEOUT, memory=None)
    )
    found = [outcomes[task] for task in tasks]
    for outcome in found:
        if isinstance(outcome, PcretrieveError):
            raise outcome
    return [outcome for outcome in found if not isinstance(outcome, PcretrieveError)]


def _perturbed(task: tuple[int, Path]) -> list[FloatArray]:
    """(1 + P, L) log-signatures of a mesh, clean and with P perturbations, by each of `OPTIONS`."""
    seed, path = task
    mesh, rng = read_mesh(path), np.random.default_rng(seed)
    meshes = [mesh, *(noisy(mesh, size, rng) for size in NOISE)]
    meshes += [without_faces(mesh, share, rng) for share in REMOVED]
    shapes = [Shape((Surface(each.area, unit_area_spectrum(each, N_MODES), each),)) for each in meshes]
    return [
        log_signatures(np.array([describe(shape, options).values for shape in shapes])) for options in OPTIONS
    ]
