"""Tables 3 and 4 and figure 3: retrieval in SHREC'11, alone and as the background of other shapes."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from pcretrieve.adapters.matplotlib import draw_curves
from pcretrieve.atomic import write_file
from pcretrieve.benchmarks.described import described
from pcretrieve.benchmarks.progress import progress
from pcretrieve.benchmarks.sets import ingested, read_mesh, spread
from pcretrieve.catalogue import Catalogue
from pcretrieve.errors import ShapeError
from pcretrieve.evaluation import (
    PrecisionRecall,
    Rankings,
    evaluate_rankings,
    precision_recall,
    rank,
    rank_table,
)
from pcretrieve.formats import write_mesh
from pcretrieve.ingestion.discover import discover
from pcretrieve.ingestion.labels import read_labels
from pcretrieve.matching import MATCHERS, PairwiseIndex
from pcretrieve.options import PipelineOptions, RetrievalOptions, Scale, SignatureOptions
from pcretrieve.surface.simplify import simplified

__all__ = ["retrieval_tables"]

LENGTHS = (15, 20, 23, 25, 30)

NAMES = ("NN", "FT", "ST", "E", "DCG")

# Number of levels of recall of the curves of figure 3.
N_LEVELS = 21

ELEMENTS: Sequence[str] = ("linear", "cubic")

# Number of meshes of SHREC'11 that are the background of table 4 without --full.
N_BACKGROUND = 200

# Number of faces of the meshes of SHREC'11 in the usual version, and of those that are mixed with them.
N_FACES = 500

# NN, FT, ST, E and DCG as published, for meshes of about 9,000 faces. The paper does not say by which of D1
# and D2, and with which element.
Published = Mapping[str, tuple[float, float, float, float, float]]
TABLE_3: Published = {
    "Shape-DNA": (0.998, 0.890, 0.952, 0.696, 0.975),
    "MDS-CM-BoF": (0.995, 0.913, 0.969, 0.717, 0.982),
    "meshSIFT": (0.998, 0.800, 0.851, 0.627, 0.944),
    "SD-GDM": (1.000, 0.956, 0.982, 0.728, 0.992),
    "BiHDM-L25": (0.990, 0.915, 0.979, 0.719, 0.984),
    "R-BiHDM-L30": (0.998, 0.969, 0.981, 0.729, 0.993),
    "R-BiHDM-L25": (0.998, 0.971, 0.982, 0.729, 0.994),
    "R-BiHDM-L23": (1.000, 0.971, 0.983, 0.730, 0.994),
    "R-BiHDM-L20": (1.000, 0.964, 0.982, 0.728, 0.993),
    "R-BiHDM-L15": (0.998, 0.955, 0.981, 0.726, 0.991),
}
TABLE_4: Published = {
    "Shape-DNA": (0.985, 0.841, 0.906, 0.666, 0.954),
    "meshSIFT": (0.995, 0.790, 0.890, 0.650, 0.950),
    "SD-GDM": (1.000, 0.929, 0.986, 0.731, 0.991),
    "BiHDM-L25": (1.000, 0.930, 0.983, 0.722, 0.990),
    "R-BiHDM-L30": (1.000, 0.970, 0.996, 0.739, 0.997),
    "R-BiHDM-L25": (1.000, 0.975, 0.997, 0.742, 0.998),
    "R-BiHDM-L23": (1.000, 0.976, 0.997, 0.742, 0.998),
    "R-BiHDM-L20": (1.000, 0.975, 0.997, 0.742, 0.998),
    "R-BiHDM-L15": (1.000, 0.970, 0.994, 0.739, 0.997),
}


@dataclass(frozen=True, slots=True)
class System:
    """A row of a table.

    Attributes
    ----------
    title : str
        Name in the paper.
    method : str
        A descriptor or a pairwise matcher.
    n_values : int, default 23
        Length of the descriptor.
    distance : str, default "d2"
        Distance of the signatures; "pairs" of a matcher.
    scale : {"relative", "area"}, default "relative"
        Scale of the signatures.
    element : {"linear", "cubic"}, default "linear"
        Finite element of the spectra.
    in_figure : bool, default False
        Whether figure 3 has its curve.
    """

    title: str
    method: str
    n_values: int = 23
    distance: str = "d2"
    scale: Scale = "relative"
    element: str = "linear"
    in_figure: bool = False


def _systems(*, full: bool) -> list[System]:
    """The rows of both tables: as published; with `full` also as pcretrieve has them, and the slow ones."""
    published = [
        System("Shape-DNA", "shape-dna-norm1-values", 12, "log", in_figure=True),
        System("SD-GDM", "sd-gdm-sampled", distance="d1", in_figure=True),
        System("BiHDM-L25", "bihdm-sampled", 25, in_figure=True),
        *(
            System(
                f"R-BiHDM-L{n}",
                "r-bihdm",
                n,
                distance,
                element=element,
                in_figure=(n, distance, element) == (23, "d2", "linear"),
            )
            for n in LENGTHS
            for distance in ("d1", "d2")
            for element in (ELEMENTS if full else ELEMENTS[:1])
        ),
        System("ISPM", "ispm", 59, "log", in_figure=True),
    ]
    ours = [
        System("R-BiHDM-L23 by area", "r-bihdm", scale="area"),
        System("default, without whitening", "combined", 59, "log", "area", in_figure=True),
    ]
    if not full:
        return published + ours
    return [
        *published,
        System("MDS-CM-BoF", "mds-cm-bof", distance="pairs", in_figure=True),
        System("meshSIFT", "meshsift", distance="pairs", in_figure=True),
        System("ShapeGoogle", "hks-bow-gallery", distance="pairs", in_figure=True),
        System("HAPT", "hapt", distance="log", in_figure=True),
        System("HAPT with R-BiHDM-L23", "hapt+r-bihdm", distance="log"),
        System("Shape-DNA by logarithms", "shape-dna-norm1", 12, "log"),
        System("SD-GDM by area elements", "sd-gdm"),
        System("BiHDM-L25 by area elements", "bihdm", 25),
        *ours,
    ]


def retrieval_tables(part: str, data: Path, output: Path | None, *, full: bool) -> Iterator[str]:
    """Table 3 or table 4, and its precision–recall curves (figure 3).

    The queries of table 4 are the meshes of TOSCA, simplified to as many faces as those of SHREC'11, which
    are their unlabelled background; the 200 deformed meshes of the paper are no longer published.

    Parameters
    ----------
    part : {"table3", "table4"}
        Which table.
    data : Path
        The folder of the sets ``shrec11`` and ``tosca``.
    output : Path or None
        The folder in which figure 3 is written, as a picture and a CSV file; None for none.
    full : bool
        Whether the tables have cubic elements and slow systems too, and table 4 all meshes of SHREC'11.

    Yields
    ------
    str
        A line of the table.

    Raises
    ------
    InputError
        If a picture is asked for, and matplotlib is not installed.
    """
    with TemporaryDirectory() as temporary:
        folder, labels, published = data / "shrec11", None, TABLE_3
        title, elements = f"Table 3: SHREC'11, {N_FACES} faces", ELEMENTS if full else ELEMENTS[:1]
        if part == "table4":
            folder, published = Path(temporary) / "mixed", TABLE_4
            labels = _mixed(data, folder, None if full else N_BACKGROUND)
            n_others = len(list(folder.iterdir())) - len(labels)
            title = f"Table 4: TOSCA among {n_others} unlabelled meshes of SHREC'11, {N_FACES} faces"
        yield f"{title}; in parentheses the measures of the paper, of other meshes"
        curves: dict[str, PrecisionRecall] = {}
        yield f"{'system':<28}{'FEM':<8}{'D':<6}" + "".join(f"{name:<14}" for name in (*NAMES, "mAP"))
        for element in elements:
            options = PipelineOptions().changed(surface={"mode": "keep"}, spectral={"element": element})
            with ingested(folder, Path(temporary) / f"{element}.sqlite", options, labels) as (catalogue, _):
                systems = [system for system in _systems(full=full) if system.element == element]
                for system in progress(systems, f"{part}, {element}"):
                    ranked = (
                        _matched(catalogue, system)
                        if system.distance == "pairs"
                        else _ranked(catalogue, system)
                    )
                    yield _row(system, ranked, published.get(system.title))
                    if system.in_figure:
                        curves[system.title] = precision_recall(ranked, n_points=N_LEVELS)
        if output is not None:
            yield from _figure(curves, output / ("figure3a" if part == "table3" else "figure3b"))


def _mixed(data: Path, folder: Path, limit: int | None) -> dict[str, str]:
    """Write simplified meshes of TOSCA beside some of SHREC'11, and return their classes by file name."""
    folder.mkdir()
    for _, path in spread(discover([data / "shrec11"]), limit):
        (folder / f"background-{path.name}").symlink_to(path.resolve())
    classes = read_labels(data / "tosca" / "labels.csv")
    labels = {}
    for path in progress(discover([data / "tosca"]), "simplified"):
        with suppress(ShapeError):  # one mesh of TOSCA is not closed
            write_mesh(simplified(read_mesh(path), N_FACES), folder / path.name)
            labels[path.name] = classes[path.name]
    return labels


def _ranked(catalogue: Catalogue, system: System) -> Rankings:
    options = SignatureOptions(method=system.method, n_values=system.n_values, scale=system.scale)
    shapes = described(catalogue, options)
    retrieval = RetrievalOptions(distance=system.distance, whitening="none")
    return rank_table(shapes.table, retrieval, failed=shapes.failed)


def _matched(catalogue: Catalogue, system: System) -> Rankings:
    """Rank all pairs; shapes without features count as misses."""
    matcher = MATCHERS[system.method]
    ids = catalogue.signatures().ids
    index = PairwiseIndex(matcher, ids, lambda shape_id: catalogue.shape(shape_id, matcher.needs))
    classes = {record.id: record.label for record in catalogue.records()}
    labels = [classes.pop(shape_id) for shape_id in index.ids]
    return rank(index, labels, failed=classes)


def _row(system: System, ranked: Rankings, published: Sequence[float] | None) -> str:
    found = evaluate_rankings(ranked)
    values = (found.nn, found.ft, found.st, found.e, found.dcg)
    cells = [f"{value:.3f}" for value in values]
    if published is not None:
        cells = [f"{cell} ({other:.3f})" for cell, other in zip(cells, published, strict=True)]
    measures = "".join(f"{cell:<14}" for cell in cells)
    return f"{system.title:<28}{system.element:<8}{system.distance:<6}{measures}{found.map:.3f}"


def _figure(curves: Mapping[str, PrecisionRecall], stem: Path) -> Iterator[str]:
    """Write precision–recall curves as a picture and as a table."""
    levels = next(iter(curves.values())).recall
    precisions = {title: curve.precision for title, curve in curves.items()}
    draw_curves(
        stem.with_suffix(".png"), levels, precisions, x_label="recall", y_label="precision", scale="linear"
    )
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(["recall", *precisions])
    writer.writerows(zip(levels.tolist(), *(row.tolist() for row in precisions.values()), strict=True))
    write_file(stem.with_suffix(".csv"), table.getvalue().encode())
    yield f"wrote {stem}.png and {stem}.csv"
