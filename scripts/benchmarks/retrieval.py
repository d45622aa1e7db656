"""Print retrieval measures of labelled sets with every whitening and re-ranking.

    scripts/benchmark retrieval --data FOLDER --keep FOLDER

FOLDER of --data has the subfolders shrec11, tosca and shrec14_csd, as far as they are there; simulated people
and the scans in scans/ need no data. With --keep, the catalogues stay in a folder, so that the next run
computes only what is missing. Without it a run takes half an hour on one core.

Sets such as tosca-turntable are scanned by the sensors of scripts/benchmark grades, on which the descriptors
were not chosen; they are computed only if --only names them.

With --no-match, a share of the classes is left out of the gallery. "sure" is the share of right answers among
those that are called sure, "given" the share of the right answers that are. The last columns say how good the
answer "no match" is, if a match must have a score of .9: precision is the share of these answers to queries
whose class is left out; recall the share of these queries with this answer; "matched" the share of the other
queries that have a match, and "right" the share of these matches that are of the class.

With --atoms, the atoms of dl-supervised are learned from half of the classes, or of the shapes of each
class, and judged by the other half without whitening: means and extremes of five random halves.

Whitenings by neighbours and PCA are fitted to all shapes of a set, without labels. Within-class whitening is
fitted by grouped folds; if lists are re-ranked, the gallery of a query is its fold. "3-people" is fitted to
three random classes, as by `lab calibrate`, which are neither queries nor in the gallery: the mean,
and below it the standard deviation, of fifty draws. The vectors of SHREC'14 are those of Chiotellis et al.
(ECCV 2016), compared as they are and, in the sets whose names end in "log", by their logarithms, as the
signatures of pcretrieve.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.bodies import Body
from benchmarks.measuring import (
    MEASURES,
    Column,
    Table,
    add_data,
    argument_parser,
    evaluate_table,
    measure_values,
    print_lines,
    use_one_core,
)
from benchmarks.sensors import SENSORS
from benchmarks.sets import (
    SETS,
    Item,
    Writer,
    ingested,
    left_out,
    pooled_vectors,
    write_clean,
    write_scanned,
    written_set,
)
from benchmarks.simulation import write_ply
from pcretrieve.catalogue import Catalogue
from pcretrieve.errors import BenchmarkError, OptionError
from pcretrieve.evaluation import rank_table
from pcretrieve.evaluation.measures import evaluate_rankings
from pcretrieve.evaluation.rankings import NO_FAILURES
from pcretrieve.gallery.answers import SURE
from pcretrieve.gallery.fitted import signatures
from pcretrieve.options import PipelineOptions, RetrievalOptions, SignatureOptions
from pcretrieve.retrieval import People, pairwise, people, table_whitening
from pcretrieve.retrieval.distances import table_coordinates
from pcretrieve.retrieval.scores import fit_scores
from pcretrieve.retrieval.whitening import CALIBRATED, calibrated_whitening
from pcretrieve.shrec.dl import learned_atoms
from pcretrieve.values import FloatArray, Metric, SignatureTable

MESHES = {"shrec11": "shrec11", "tosca": "tosca", "people": "humans"}
SCANS = {
    "tosca-scans": "tosca",
    "tosca-sensors": "tosca",
    "people-scans": "humans",
    "samples": "scans",
}

# Sets that other sensors scan: the set of meshes, and the sensor of `benchmarks.sensors`. A run that names no
# sets has none of them.
BY_SENSOR = {
    f"{name}-{sensor}": (source, sensor)
    for name, source in (("tosca", "tosca"), ("people", "humans"))
    for sensor in ("nine", "uniform", "turntable")
}
SOURCES = MESHES | SCANS | {name: source for name, (source, _) in BY_SENSOR.items()}
VECTORS: dict[str, tuple[str, Metric]] = {
    "shrec14-real": ("real.mat", "values"),
    "shrec14-synthetic": ("synthetic.mat", "values"),
    "shrec14-real-log": ("real.mat", "logarithms"),
    "shrec14-synthetic-log": ("synthetic.mat", "logarithms"),
}
NAMES = (*MESHES, *SCANS, *VECTORS)
WHITENINGS = ("none", "pca", "neighbours", "unsupervised", "within-class")

# Numbers of people to whom a whitening is fitted for the others, where there are as many others.
CALIBRATIONS = (3, 10)
PEOPLE = ("people-scans", *VECTORS)

# The condition of `scripts/benchmark fidelity` under which the meshes of a set are scanned.
CONDITIONS = {
    "tosca-scans": "typical-uniform",
    "tosca-sensors": "typical-uniform-sensors",
    "people-scans": "typical-uniform",
}

TABLE = Table(
    Column("set", 21, align="<"),
    Column("method", 16, align="<"),
    Column("L", 4),
    Column("whitening", 12, align="<"),
    Column("re-ranking", 12, align="<"),
    *(Column(title, 6, ".4f") for title in MEASURES),
)

# Shares of the classes that are left out, and the columns of the table of "no match".
LEFT_OUT = (0.1, 0.5)
NO_MATCH_TABLE = Table(
    Column("set", 21, align="<"),
    Column("scores from", 12, align="<"),
    Column("whitening", 22, align="<"),
    Column("out", 5, ".1f"),
    *(
        Column(title, 9, ".3f")
        for title in ("sure", "given", "precision", "recall", "matched", "right")
    ),
)

N_HALVES = 5
ATOMS_TABLE = Table(
    Column("set", 21, align="<"),
    Column("half of", 10, align="<"),
    *(Column(title, 9, ".4f") for title in ("shipped", "learned", "gain", "from", "to")),
)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argument_parser(__doc__)
    add_data(parser)
    parser.add_argument(
        "--only",
        nargs="+",
        choices=(*NAMES, *BY_SENSOR),
        default=NAMES,
        help="some sets only",
    )
    parser.add_argument(
        "--samples", type=Path, default=Path("scans"), help="folder of the sample scans"
    )
    parser.add_argument(
        "--methods", nargs="+", default=["hapt+r-bihdm"], help="descriptors"
    )
    parser.add_argument(
        "--n-values", type=int, nargs="+", default=[23], help="lengths of the descriptors"
    )
    parser.add_argument(
        "--keep", type=Path, metavar="FOLDER", help="keep the catalogues in this folder"
    )
    parser.add_argument(
        "--no-match",
        action="store_true",
        help='print how good the answer "no match" is, on classes left out',
    )
    parser.add_argument(
        "--atoms",
        action="store_true",
        help="print what atoms learned from labels are worth",
    )
    given = parser.parse_args(arguments)
    use_one_core()
    print_lines(_lines(given))


def _lines(given: argparse.Namespace) -> Iterator[str]:
    yield (
        ATOMS_TABLE if given.atoms else NO_MATCH_TABLE if given.no_match else TABLE
    ).head
    rows = _no_match_rows if given.no_match else _rows
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) if given.keep is None else given.keep
        folder.mkdir(parents=True, exist_ok=True)
        for name in given.only:
            needed = _needed(name, given)
            if missing := left_out(name, needed):
                yield missing
            elif name in VECTORS:
                file, metric = VECTORS[name]
                if given.atoms:
                    continue  # vectors have no surfaces
                yield from rows(name, pooled_vectors(needed / file, metric), None)
            else:
                yield from _catalogue_rows(name, folder, given, rows)


def _needed(name: str, given: argparse.Namespace) -> Path:
    """The folder without which a set is left out."""
    data: Path = given.data
    if name in VECTORS:
        return data / "shrec14_csd"
    if name == "samples":
        return Path(given.samples)
    source = SOURCES[name]
    return Path() if source == "humans" else data / source


def _catalogue_rows(
    name: str, folder: Path, given: argparse.Namespace, rows: Callable[..., Iterator[str]]
) -> Iterator[str]:
    options = PipelineOptions()
    if name in MESHES:
        options = options.changed(surface={"mode": "keep"})
    source, labels = _files(name, folder, given)
    with ingested(source, folder / f"{name}.sqlite", options, labels) as (catalogue, _):
        if given.atoms:
            yield from _atoms_rows(name, catalogue, options)
            return
        failed = {
            record.id: record.label for record in catalogue.records(status="failed")
        }
        for method in given.methods:
            for n_values in given.n_values:
                try:
                    chosen = options.changed(
                        signature={
                            "method": method,
                            "n_values": n_values,
                            "scale": "area",
                        }
                    )
                    table = signatures(catalogue, options=chosen)
                except OptionError as error:
                    yield f"{name} {method} {n_values}: left out, {error.message}"
                    continue
                yield from rows(name, table, chosen.signature, failed)


def _files(
    name: str, folder: Path, given: argparse.Namespace
) -> tuple[Path, dict[str, str] | None]:
    """The folder of the files of a set, which are written if they do not exist, and their classes."""
    if name == "samples" or MESHES.get(name) in ("shrec11", "tosca"):
        return _needed(name, given), None
    files = folder / f"{name}-files"
    write: Writer = write_clean
    if name in BY_SENSOR:
        write = partial(_scanned, BY_SENSOR[name][1])
    elif name in CONDITIONS:
        write = partial(write_scanned, CONDITIONS[name])
    return files, written_set(SETS[SOURCES[name]](given.data, None), files, write)


def _scanned(sensor: str, item: Item, folder: Path) -> Path:
    """Write a scan of an item by a sensor."""
    path, body = folder / f"{item.name}.ply", Body(item.name, item.label, item.mesh)
    write_ply(path, SENSORS[sensor](body, np.random.default_rng(item.number)))
    return path


def _rows(
    name: str,
    table: SignatureTable,
    options: SignatureOptions | None,
    failed: Mapping[str, str | None] = NO_FAILURES,
) -> Iterator[str]:
    """One line for each whitening and re-ranking, and two for each calibration."""
    for kind in WHITENINGS:
        whitening = None
        if kind != "within-class":
            known = None if options is None else people(options)
            whitening = table_whitening(
                table, RetrievalOptions(whitening=kind), people=known
            )
        retrieval = RetrievalOptions(whitening=kind, rerank="k-reciprocal")
        again, plain = rank_table(table, retrieval, whitening=whitening, failed=failed)
        if kind == "within-class":  # without re-ranking, the gallery is the whole set
            plain, _ = rank_table(table, RetrievalOptions(whitening=kind), failed=failed)
        for method, rankings in (("none", plain), (retrieval.rerank, again)):
            measures = measure_values(evaluate_rankings(rankings))
            yield TABLE.row(
                name, table.kind, table.values.shape[1], kind, method, *measures
            )
    n_people = len(set(table.labels)) if name in PEOPLE else 0
    for number in CALIBRATIONS:
        if 2 * number < n_people:
            known = None if options is None else people(options)
            rows = calibrated_measures(table, number, moments=known, failed=failed)
            facts = name, table.kind, table.values.shape[1]
            yield TABLE.row(*facts, f"{number}-people", "none", *rows.mean(axis=0))
            yield TABLE.row(
                *facts, f"{number}-people", "deviation", *rows.std(axis=0, ddof=1)
            )


def _no_match_rows(
    name: str,
    table: SignatureTable,
    options: SignatureOptions | None,
    failed: Mapping[str, str | None] = NO_FAILURES,
) -> Iterator[str]:
    """Lines for scores from labels and without labels; failed shapes are left out."""
    known = None if options is None else people(options)
    for labelled, out in product((True, False), LEFT_OUT):
        found = no_match_measures(table, left_out=out, labelled=labelled, moments=known)
        facts = name, "labels" if labelled else "neighbours", found.whitening, out
        yield NO_MATCH_TABLE.row(
            *facts,
            found.sure,
            found.given,
            found.precision,
            found.recall,
            found.matched,
            found.right,
        )


def _atoms_rows(
    name: str, catalogue: Catalogue, options: PipelineOptions
) -> Iterator[str]:
    """What learned atoms are worth for other classes, and for other shapes of the same classes."""
    shipped = options.changed(signature={"method": "dl-supervised"})
    before = signatures(catalogue, options=shipped)
    labels = {
        key: label
        for key, label in zip(before.ids, before.labels, strict=True)
        if label is not None
    }
    retrieval = RetrievalOptions(whitening="none")
    for what in ("classes", "shapes"):
        rng, rows = np.random.default_rng(SEED), []
        for _ in range(N_HALVES):
            kinds = rng.permutation(sorted(set(labels.values()))).tolist()
            known = {
                key for key, label in labels.items() if label in kinds[: len(kinds) // 2]
            }
            if what == "shapes":
                members = [
                    [key for key, label in labels.items() if label == kind]
                    for kind in kinds
                ]
                known = {
                    key
                    for own in members
                    for key in rng.permutation(own)[: (len(own) + 1) // 2].tolist()
                }
            own = {key: labels[key] for key in sorted(known)}
            atoms = learned_atoms(
                map(catalogue.mesh, own), [*own.values()], shipped.signature.n_modes
            )
            after = signatures(
                catalogue, options=shipped.changed(signature={"atoms": atoms.tolist()})
            )
            others = [key for key in labels if key not in known]
            rows.append(
                [
                    evaluate_table(one.select(others), retrieval).map
                    for one in (before, after)
                ]
            )
        gains = np.diff(rows, axis=1)
        yield ATOMS_TABLE.row(
            name, what, *np.mean(rows, axis=0), gains.mean(), gains.min(), gains.max()
        )


# Random draws of the classes of the fit, and their seed.
N_DRAWS, SEED = 50, 0


def calibrated_measures(
    table: SignatureTable,
    n_classes: int,
    *,
    moments: People | None = None,
    failed: Mapping[str, str | None] = NO_FAILURES,
) -> FloatArray:
    """(50, 6) retrieval measures, as in `MEASURES`, of random draws of the classes of the fit."""
    options = RetrievalOptions()
    rng = np.random.default_rng(SEED)
    classes = sorted({label for label in table.labels if label is not None})
    rows = []
    for _ in range(N_DRAWS):
        drawn = {
            classes[number]
            for number in rng.choice(len(classes), n_classes, replace=False)
        }
        fitted = [
            shape_id
            for shape_id, label in zip(table.ids, table.labels, strict=True)
            if label in drawn
        ]
        others = [shape_id for shape_id in table.ids if shape_id not in set(fitted)]
        whitening = replace(
            calibrated_whitening(table.select(fitted), options, moments), kind=CALIBRATED
        )
        misses = {
            shape_id: label for shape_id, label in failed.items() if label not in drawn
        }
        measures = evaluate_table(
            table.select(others), options, whitening=whitening, failed=misses
        )
        rows.append(measure_values(measures))
    return np.array(rows)


# --- no match -------------------------------------------------------------------------------------------

# Share of the shapes of a class that are queries; the others are in the gallery, if the class is.
QUERIES = 1 / 3

# Least number of shapes of a class, so that a query has two shapes in the gallery, which form a pair.
SMALLEST = 3


@dataclass(frozen=True, slots=True)
class NoMatchMeasures:
    """How good the answer "no match" is.

    right: of these matches, the share of the class of the query; NaN if there are none.
    """

    sure: float
    given: float
    precision: float
    recall: float
    matched: float
    right: float
    whitening: str
    n_queries: int


def no_match_measures(
    table: SignatureTable,
    options: RetrievalOptions | None = None,
    *,
    min_score: float = 0.9,
    left_out: float = 0.5,
    labelled: bool = True,
    moments: People | None = None,
    n_draws: int = 10,
    seed: int = 0,
) -> NoMatchMeasures:
    """Search galleries without some of the classes for shapes of all classes, with a least score.

    A third of the shapes of each class are queries, which neither the whitening nor the scores are fitted to.

    moments: as `people` of `pcretrieve.retrieval.fit_whitening`.
    """
    options = options or RetrievalOptions()
    rng = np.random.default_rng(seed)
    used: set[str] = set()
    drawn = []
    for _ in range(n_draws):
        gallery, queries = _split(table, rng, left_out)
        ids = [table.ids[row] for row in gallery]
        shapes = table.select(ids)
        if not labelled:
            shapes = replace(shapes, labels=(None,) * len(ids))
        whitening = table_whitening(shapes, options, people=moments)
        used.add(whitening.kind)
        scores = fit_scores(shapes, whitening, options)
        points = whitening.apply(table_coordinates(table, options.distance))
        distances = pairwise(options.distance, points[queries], points[gallery])
        nearest = distances.argmin(axis=1)
        labels = np.array(table.labels, dtype=object)
        ours, found = labels[queries], labels[gallery[nearest]]
        known = np.isin(ours.astype(str), labels[gallery].astype(str))
        # Without scores there is no match that is certain enough.
        score = (
            np.zeros(len(queries)) if scores is None else scores.of(distances.min(axis=1))
        )
        others = np.where(found[:, np.newaxis] == labels[gallery], np.inf, distances).min(
            axis=1
        )
        pairs = zip(distances.min(axis=1), others, strict=True)
        sure = [
            scores is not None and (scores.certainty(*pair) or 0) >= SURE
            for pair in pairs
        ]
        drawn.append(
            np.stack([known, score >= min_score, ours == found, sure]).astype(bool)
        )
    known, matched, same, sure_ones = np.concatenate(drawn, axis=1)

    def share(of: NDArray[np.bool_], among: NDArray[np.bool_]) -> float:
        return float(of[among].mean()) if among.any() else float("nan")

    return NoMatchMeasures(
        sure=share(same, sure_ones),
        given=share(sure_ones, same),
        precision=share(~known, ~matched),
        recall=share(~matched, ~known),
        matched=share(matched, known),
        right=share(same, known & matched),
        whitening=" or ".join(sorted(used)),
        n_queries=len(known),
    )


def _split(
    table: SignatureTable, rng: np.random.Generator, left_out: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The rows of a gallery without a share of the classes, and of queries of all classes."""
    labels = np.array(["" if label is None else label for label in table.labels])
    sizes = {label: int((labels == label).sum()) for label in sorted({*labels} - {""})}
    classes = [label for label, size in sizes.items() if size >= SMALLEST]
    if len(classes) < 2:
        raise BenchmarkError(
            f"classes can be left out of two classes of {SMALLEST} shapes or more, got {len(classes)}"
        )
    known = set(
        rng.permutation(classes)[
            : len(classes) - max(1, round(left_out * len(classes)))
        ].tolist()
    )
    gallery: list[int] = []
    queries: list[int] = []
    for label in classes:
        rows = rng.permutation(np.flatnonzero(labels == label)).tolist()
        n_queries = max(1, int(len(rows) * QUERIES))
        queries += rows[:n_queries]
        if label in known:
            gallery += rows[n_queries:]
    return np.array(sorted(gallery)), np.array(queries)
