"""Table 5: retrieval of people, by the published vectors and meshes of SHREC'14 or by simulated people."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from pcretrieve.benchmarks.described import described
from pcretrieve.benchmarks.progress import progress
from pcretrieve.benchmarks.sets import SETS, ingested
from pcretrieve.benchmarks.written import pooled_vectors, written_set
from pcretrieve.catalogue import Catalogue
from pcretrieve.evaluation import PUBLISHED, evaluate_rankings, rank_table
from pcretrieve.ingestion.layouts import discover_labelled
from pcretrieve.options import PipelineOptions, RetrievalOptions, Scale, SignatureOptions
from pcretrieve.retrieval import table_whitening
from pcretrieve.values import Metric

__all__ = ["Track", "table_5", "track"]

TRACKS = ("synthetic", "real")

# How simulated people are scanned for the real track; those of the synthetic track are clean meshes.
CONDITION = "typical-uniform"

# Number of bodies of simulated people, of 100, without --full.
N_BODIES = 30


class System(NamedTuple):
    """A row of the table.

    Attributes
    ----------
    published : str or None
        Name in `PUBLISHED`; None if the paper does not have the method.
    method : str
        A descriptor.
    n_values : int
        Length of the descriptor.
    scale : {"relative", "area"}
        Scale of the signatures.
    distance : {"log", "d2"}
        Distance of the signatures.
    """

    published: str | None
    method: str
    n_values: int
    scale: Scale = "area"
    distance: str = "log"


class Track(NamedTuple):
    """The meshes or scans of a track.

    Attributes
    ----------
    title : str
        Their number, and what they are.
    folder : Path
        Where their files are.
    options : PipelineOptions
        How they are ingested.
    labels : dict of str to str
        Their classes, by file name or by path.
    """

    title: str
    folder: Path
    options: PipelineOptions
    labels: dict[str, str]


SYSTEMS = (
    System("ISPM", "ispm", 59),
    System("HAPT", "hapt", 45),
    System("unsupervised dictionary learning", "dl", 32),
    System("supervised dictionary learning", "dl-supervised", 32),
    System("ShapeGoogle (VQ)", "hks-bow", 59),
    System("R-BiHDM-s", "r-bihdm", 23, "relative", "d2"),
    System("R-BiHDM-s", "r-bihdm", 59),
    System(None, "bihdm", 59),
    System(None, "shape-dna", 59),
    System(None, "hapt+r-bihdm", 59),
    System(None, "combined", 59),
)

# The vectors, by what is compared; and the whitenings, of which the last one is fitted by grouped folds.
METRICS: tuple[Metric, ...] = ("values", "logarithms")
WHITENINGS = ("none", "neighbours", "within-class")


def table_5(data: Path, *, full: bool) -> Iterator[str]:
    """The mAP of people, by our methods and as published.

    A track is measured on its meshes where the folder of the data has a folder by the name of its layout,
    ``shrec14-synthetic`` or ``shrec14-real``; else on ten simulated people, as clean meshes or as scans.

    Parameters
    ----------
    data : Path
        The folder of the sets. The vectors are in its folder ``shrec14_csd``, and left out if they are not.
    full : bool
        Whether all poses of the simulated people are taken, and scans of them.

    Yields
    ------
    str
        A line of the table.
    """
    published = {name: _published(name) for name in TRACKS}
    yield "Table 5: mAP of people without whitening; in parentheses that of the paper, of SHREC'14"
    measured: dict[str, dict[System, float]] = {}
    with TemporaryDirectory() as temporary:
        for name in TRACKS:
            if name == "real" and not full and not (data / "shrec14-real").is_dir():
                measured[name] = {}
                yield "real: left out; --full has scans of simulated people"
                continue
            made = track(name, data, Path(temporary), None if full else N_BODIES)
            yield f"{name}: {made.title}"
            file = Path(temporary) / f"{name}.sqlite"
            with ingested(made.folder, file, made.options, made.labels) as (catalogue, _):
                measured[name] = {system: _map(catalogue, system) for system in progress(SYSTEMS, name)}
    yield f"{'method':<16}{'L':<4}{'scale':<10}{'D':<5}" + "".join(f"{name:<16}" for name in TRACKS).rstrip()
    for system in SYSTEMS:
        cells = [_cell(measured[name].get(system), published[name].get(system.published)) for name in TRACKS]
        facts = f"{system.method:<16}{system.n_values:<4}{system.scale:<10}{system.distance:<5}"
        yield facts + "".join(f"{cell:<16}" for cell in cells).rstrip()
    if (data / "shrec14_csd").is_dir():
        yield from _vector_rows(data / "shrec14_csd")


def _map(catalogue: Catalogue, system: System) -> float:
    options = SignatureOptions(method=system.method, n_values=system.n_values, scale=system.scale)
    shapes = described(catalogue, options)
    retrieval = RetrievalOptions(distance=system.distance, whitening="none")
    return evaluate_rankings(rank_table(shapes.table, retrieval, failed=shapes.failed)).map


def _vector_rows(folder: Path) -> Iterator[str]:
    """A row for each whitening of the published vectors."""
    yield ""
    yield "SHREC'14 itself, by the descriptors of Chiotellis et al. (ECCV 2016), mAP"
    yield f"{'compared':<16}{'whitening':<19}" + "".join(f"{name:<16}" for name in TRACKS).rstrip()
    for metric in METRICS:
        tables = [pooled_vectors(folder / f"{name}.mat", metric) for name in TRACKS]
        for kind in WHITENINGS:
            retrieval = RetrievalOptions(whitening=kind)
            cells = []
            for table in tables:
                fitted = None if kind == "within-class" else table_whitening(table, retrieval)
                cells.append(f"{evaluate_rankings(rank_table(table, retrieval, whitening=fitted)).map:.3f}")
            yield f"{metric:<16}{kind:<19}" + "".join(f"{cell:<16}" for cell in cells).rstrip()


def _published(track: str) -> dict[str | None, float | None]:
    return {row.method: row.measures[-1] for row in PUBLISHED[f"shrec14-{track}"]}


def _cell(measured: float | None, published: float | None) -> str:
    found = "-" if measured is None else f"{measured:.3f}"
    return found if published is None else f"{found} ({published:.3f})"


def track(name: str, data: Path, temporary: Path, n_bodies: int | None) -> Track:
    """The meshes of a track of SHREC'14, or else simulated people.

    Parameters
    ----------
    name : {"synthetic", "real"}
        The track.
    data : Path
        The folder that may have the meshes, in a folder by the name of their layout.
    temporary : Path
        The folder in which the files of simulated people are written.
    n_bodies : int or None
        Number of bodies of simulated people; None for all.

    Returns
    -------
    Track
        Clean meshes in the synthetic track, and scans in the real one, if people are simulated.
    """
    keep = PipelineOptions().changed(surface={"mode": "keep"})
    layout = f"shrec14-{name}"
    folder = data / layout
    if folder.is_dir():
        paths, labels = discover_labelled([folder], layout)
        return Track(f"{len(paths)} meshes of {layout}", folder, keep, labels)
    items, folder = SETS["humans"](data, n_bodies), temporary / name
    if name == "synthetic":
        labels = written_set(items, folder, None)
        return Track(f"{len(items)} clean meshes of simulated people", folder, keep, labels)
    labels = written_set(items, folder, CONDITION)
    return Track(f"{len(items)} scans of simulated people, reconstructed", folder, PipelineOptions(), labels)
