"""Print how often the right person is found among how many, and learn the metric of people.

    scripts/make_people --out seen --people 1500 --seed 1     # and others of other seeds
    pcretrieve ingest seen --labels seen/labels.csv -c seen.sqlite
    scripts/benchmark people seen.sqlite --unseen 1000        # learns from the others, and prints the curve
    scripts/make_people --out many --people 600 --seed 71 --poses 4 --sensors cameras uniform turntable steps
    pcretrieve ingest many --labels many/labels.csv -c many.sqlite
    scripts/benchmark people seen.sqlite many.sqlite --learn  # writes pcretrieve/retrieval/people.npz
    scripts/benchmark people others.sqlite --coarser          # adds what coarser meshes of scans change
    scripts/benchmark people --refer bodies --judge           # what distances of others mean is worth
    scripts/benchmark people --refer bodies --limit 60        # adds it to the package

Each scan is a query in all other scans. Rank-1 is the share of queries whose nearest scan is of the same
person; rank-5, of which one of the nearest five people is this person. They are the expected values over all
galleries of n of the people, of which none is drawn. Pairs of scans are of one person or of two: the equal
error rate (EER) is where the shares of wrong answers are the same for both, and FNMR the share of pairs of
one person that are refused where one in a thousand pairs of two people is accepted. Beyond the people that
there are, 1 − rank-1 is continued as a power of n; these rows are marked as fitted. "form and size" is by
`--size-weight 6`.

The metric is that of the covariances within and between people: see `pcretrieve.retrieval.people`.
"""

from __future__ import annotations

import io
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import pcretrieve.retrieval
from benchmarks.bodies import Body, Sources, anny
from benchmarks.judging import examined, metric_of_people
from benchmarks.measuring import (
    Column,
    Table,
    all_in_workers,
    argument_parser,
    draw_curves,
    print_lines,
)
from benchmarks.sensors import DAMAGES, SENSORS, WHOLE
from benchmarks.sets import to_faces
from pcretrieve.catalogue import Catalogue
from pcretrieve.descriptors import DESCRIPTORS, describe
from pcretrieve.descriptors.hapt import RADII, WEIGHTS
from pcretrieve.errors import BenchmarkError, ShapeError
from pcretrieve.evaluation.measures import recognition_curve, verification
from pcretrieve.gallery.answers import SURE
from pcretrieve.gallery.fitted import signatures
from pcretrieve.options import (
    PipelineOptions,
    RetrievalOptions,
    SignatureOptions,
    fused_names,
)
from pcretrieve.pipeline.process import process
from pcretrieve.retrieval import (
    Positions,
    coordinates,
    fit_whitening,
    pairwise,
    people,
    table_whitening,
)
from pcretrieve.retrieval.people import (
    BEGINS,
    RATES,
    SAMPLE,
    SYMMETRIC,
    Reference,
    installed,
)
from pcretrieve.retrieval.scores import (
    Trials,
    features,
    fit_scores,
    fitted_coefficients,
)
from pcretrieve.values import FloatArray, PointCloud, SignatureTable
from pcretrieve.values.files import write_file

# The smallest collection of the curve, and the weight of the size: that of a body scanner.
SMALLEST = 100
SIZE_WEIGHT = PipelineOptions.of("body-scanner").signature.size_weight

TABLE = Table(
    Column("method", 13, align="<"),
    Column("compared", 14, align="<"),
    Column("whitening", 10, align="<"),
    Column("people", 7, ",d"),
    *(Column(title, 7, ".4f") for title in ("rank-1", "rank-5", "EER", "FNMR")),
    Column("", 7, align="<"),
)


class SensorScans(NamedTuple):
    """Coordinates of the default signature (n, L), and the person (n,) of each of n scans by one sensor."""

    points: FloatArray
    person: Positions


class Scans(NamedTuple):
    """Coordinates of the three parts (n, 154), (n, 59), (n, 1), and the person (n,) of each of n scans.

    ids: (n,) of the shapes; files of `make_people --sensors` have the sensor in their names.
    """

    parts: dict[str, FloatArray]
    person: Positions
    ids: NDArray[np.str_]


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the curve, or learn."""
    parser = argument_parser(__doc__)
    parser.add_argument(
        "catalogues", nargs="*", type=Path, help="catalogues of labelled scans of people"
    )
    parser.add_argument(
        "--unseen",
        type=int,
        help="judge by so many people, drawn at random, and learn from others",
    )
    parser.add_argument(
        "--learn", action="store_true", help="write the moments into the package"
    )
    parser.add_argument(
        "--coarser",
        action="store_true",
        help="add what coarser meshes of the scans change",
    )
    parser.add_argument(
        "--refer",
        type=Path,
        metavar="BODIES",
        help="add what distances mean, of people who taught nothing (make_people --bodies)",
    )
    parser.add_argument(
        "--judge",
        action="store_true",
        help="print the answers of collections of one or two scans a person, each sensor left out once",
    )
    parser.add_argument(
        "--limit", type=int, default=60, help="people of --refer (default: %(default)s)"
    )
    parser.add_argument(
        "--sensors",
        nargs="+",
        choices=SENSORS,
        default=["turntable", "uniform", "nine"],
        help="sensors of --refer",
    )
    parser.add_argument(
        "--methods", nargs="+", default=["hapt+r-bihdm", "hapt", "r-bihdm"]
    )
    parser.add_argument("--draw", type=Path, metavar="PICTURE", help="draw the curve")
    given = parser.parse_args(arguments)
    scans = {}
    if given.refer:
        scans = {name: scans_by(name, given.refer, given.limit) for name in given.sensors}
    if given.judge:
        if len(scans) < 2:
            parser.error("--judge leaves a sensor out: give --refer, and two --sensors")
        print_lines(_judged(scans, installed()))
        return
    if given.learn or given.coarser or given.refer:
        sample = learned(scans_of(given.catalogues)) if given.learn else installed()
        if given.coarser:
            changed = coarser(given.catalogues) / np.outer(
                sample["scale"], sample["scale"]
            )
            sample |= {name: sample[name] + changed for name in ("within", "total")}
        if given.refer:
            sample |= reference([*scans.values()], sample)._asdict()
        written = io.BytesIO()
        np.savez_compressed(written, allow_pickle=False, **packed(sample))
        target = Path(pcretrieve.retrieval.__file__).with_name(SAMPLE)
        write_file(target, written.getvalue())
    else:
        print_lines(
            _lines(scans_of(given.catalogues), given.methods, given.unseen, given.draw)
        )


def packed(sample: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """The arrays of `SAMPLE` as they are stored: float32, and the upper triangles of symmetric matrices."""
    upper = np.triu_indices(len(sample["mean"]))
    triangles = {name: sample[name][upper] for name in SYMMETRIC}
    stored = {**sample} | triangles
    return {name: np.asarray(array, np.float32) for name, array in stored.items()}


def scans_of(catalogues: Sequence[Path]) -> Scans:
    """The coordinates of all scans of some catalogues, of which no two have a person in common."""
    parts: dict[str, list[FloatArray]] = {"hapt": [], "r-bihdm": [], "size": []}
    labels, ids = list[str](), list[str]()
    for number, path in enumerate(catalogues):
        with Catalogue(path) as catalogue:
            for method in BEGINS:
                options = catalogue.options.changed(
                    signature={"method": method, "n_values": 59}
                )
                table = signatures(catalogue, options=options)
                parts[method].append(coordinates(table.values, table.metric))
            areas = {
                record.id: record.area or 0.0
                for record in catalogue.records(status="done")
            }
            parts["size"].append(
                np.log(np.array([[areas[shape_id]] for shape_id in table.ids]))
            )
            labels += [f"{number} {label}" for label in table.labels]
            ids += table.ids
    person = np.unique(labels, return_inverse=True)[1]
    joined = {name: np.concatenate(blocks) for name, blocks in parts.items()}
    return Scans(joined, person, np.array(ids))


# Shrinkage of the covariance within people towards its own diagonal, and least variance within people
# relative to the mean: some bins of hapt are empty for nearly all people.
SHRINKAGE, LEAST = 0.03, 3e-3

# How often a damaged scan counts within people: a twelfth of the scans are damaged. See docs/decisions.md,
# drawn sensors.
DAMAGED = 2.0

# What the coordinates of hapt are divided by before that, (r, l): without the weights, they are roots of
# volumes relative to R², of about the same variance within people.
EVEN = np.sqrt(WEIGHTS) * RADII[:, np.newaxis]


def person_means(points: FloatArray, person: Positions) -> FloatArray:
    """(p, L) means of the coordinates (n, L) of each person."""
    sums = np.stack([np.bincount(person, column) for column in points.T], axis=1)
    return np.asarray(sums / np.bincount(person)[:, np.newaxis])


def damages_of(scans: Scans) -> NDArray[np.str_]:
    """(n,) the damages in names of files of `make_people`: with --sensors, they may have one."""
    found = [name.rpartition("_")[2] for name in scans.ids.tolist()]
    return np.array([damage if damage in DAMAGES else WHOLE for damage in found])


def shrunk_within(within: FloatArray) -> FloatArray:
    """A covariance within people, shrunk, and with a least variance."""
    variances = np.diag(within)
    floor = LEAST * variances.mean() * np.eye(len(within))
    return np.asarray((1 - SHRINKAGE) * within + SHRINKAGE * np.diag(variances) + floor)


def learned(scans: Scans) -> dict[str, FloatArray]:
    """The arrays of `SAMPLE`."""
    scale = np.array(
        [DESCRIPTORS[name].spread if name in BEGINS else 1.0 for name in scans.parts]
    )
    scale = np.repeat(scale, [part.shape[1] for part in scans.parts.values()])
    points = np.concatenate(list(scans.parts.values()), axis=1) / scale
    even = EVEN.ravel()
    even = even * np.sqrt((points[:, : len(even)] / even).var(axis=0).sum())
    unit = np.append(even, np.ones(len(scale) - len(even)))
    n_of = np.bincount(scans.person)
    means = person_means(points / unit, scans.person)
    counted = np.where(damages_of(scans) == WHOLE, 1.0, DAMAGED)
    apart = points / unit - means[scans.person]
    n_free = counted.mean() * (len(points) - len(means))
    within = (counted * apart.T) @ apart / n_free
    shrunk = shrunk_within(within)
    # The covariance between people without that of the means of a few scans.
    between = np.cov(means.T) - within * (1 / n_of).mean()
    weights, directions = np.linalg.eigh(between)
    between = (directions * np.maximum(weights, 0)) @ directions.T
    units = np.outer(unit, unit)
    return {
        "mean": points.mean(axis=0),
        "within": units * shrunk,
        "total": units * (shrunk + between),
        "scale": scale,
    }


# Numbers of faces of the coarser meshes, and the share of what they change in the covariance within people:
# see docs/decisions.md, coarser.
N_FACES, COARSER = (1000, 2000, 3000), 0.25


def coarser(catalogues: Sequence[Path]) -> FloatArray:
    """(214, 214) the share of the second moment of what coarser meshes of stored scans change."""
    tasks: list[tuple[Path, str, int]] = []
    for path in catalogues:
        with Catalogue(path) as catalogue:
            ids = [record.id for record in catalogue.records(status="done")]
        tasks += [
            (path, shape_id, N_FACES[row % len(N_FACES)])
            for row, shape_id in enumerate(ids)
        ]
    changes = np.array(
        [
            change
            for change in all_in_workers(_changed, tasks, "coarser")
            if change is not None
        ]
    )
    return np.asarray(COARSER * changes.T @ changes / len(changes))


def _changed(task: tuple[Path, str, int]) -> FloatArray | None:
    """(214,) what the coordinates change by if the mesh of a scan has so many faces; None if it fails."""
    path, shape_id, n_faces = task
    options = PipelineOptions().changed(surface={"mode": "keep"})
    with Catalogue(path) as catalogue:
        fine = catalogue.shape(shape_id)
    try:
        coarse = process(to_faces(n_faces, fine.mesh), options)
    except ShapeError:
        return None
    points = []
    for shape in (fine, coarse):
        made = [
            describe(shape, SignatureOptions(method=method, n_values=59))
            for method in BEGINS
        ]
        parts = [coordinates(one.values, one.metric) for one in made]
        points.append(np.concatenate([*parts, [np.log(shape.area)]]))
    return np.asarray(points[1] - points[0])


# Numbers of people, and of scans of each, in galleries of which a query is drawn, and how many queries of
# each are drawn.
GALLERIES = (3, 10, 30)
EACH = (1, 2)
N_QUERIES = 600

# Weight of a query whose person is not in the gallery: a collection that has hardly any statistics of its own
# should name no stranger. See docs/decisions.md, one scan each.
STRANGERS = 100.0

# Number of quantiles of the distances of scans of one person.
N_SAME = 201


def scans_by(sensor: str, bodies: Path, n_people: int) -> SensorScans:
    """Scan people of Anny in three poses each by one sensor, and describe them."""
    people_of = anny(Sources(Path(), bodies, 0), n_people, 3)
    tasks = [(body, sensor) for poses in people_of for body in poses]
    found = all_in_workers(_described, tasks, sensor)
    points = np.array([point for point in found if point is not None])
    names = [
        body.label
        for (body, _), point in zip(tasks, found, strict=True)
        if point is not None
    ]
    return SensorScans(points, np.unique(names, return_inverse=True)[1])


def _described(task: tuple[Body, str]) -> tuple[float, ...] | None:
    """The coordinates of the default signature of a scan of a body; None if it has no surface."""
    body, sensor = task
    rng = np.random.default_rng((7, zlib.crc32(f"{body.name} {sensor}".encode())))
    found, _ = examined(PointCloud(SENSORS[sensor](body, rng)))
    return found.point or None


def reference(
    sensors: Sequence[SensorScans], sample: Mapping[str, FloatArray]
) -> Reference:
    """What distances mean, from scans of people by several sensors; `sample` as by `learned`."""
    metric = metric_of_people(sample)
    same, apart, tried = list[FloatArray](), list[FloatArray](), list[Trials]()
    rng = np.random.default_rng(0)
    for scans in sensors:
        points = metric.apply(scans.points)
        distances = pairwise(RetrievalOptions().distance, points, points)
        first, second = np.triu_indices(len(points), k=1)
        is_same = scans.person[first] == scans.person[second]
        same.append(distances[first, second][is_same])
        apart.append(distances[first, second][~is_same])
        tried += [
            _drawn(distances, scans.person, n_people, n_each, rng)
            for n_people in GALLERIES
            for n_each in EACH
        ]
    trials = Trials(*(np.concatenate(part) for part in zip(*tried, strict=True)))
    coefficients = fitted_coefficients(trials)
    right = 1 / (1 + np.exp(-trials.features @ coefficients))
    weights = trials.weights * right * (1 - right) / trials.weights.sum()
    return Reference(
        np.quantile(np.concatenate(same), np.linspace(0, 1, N_SAME)),
        np.quantile(np.concatenate(apart), RATES),
        coefficients,
        (trials.features.T * weights) @ trials.features,
    )


def _drawn(
    distances: FloatArray,
    person: Positions,
    n_people: int,
    n_each: int,
    rng: np.random.Generator,
) -> Trials:
    """Queries in random galleries, by turns of people in them and of others."""
    known = np.flatnonzero(np.bincount(person) > n_each)
    nearest, others, right = [], [], []
    for number in range(N_QUERIES):
        chosen = rng.permutation(known)[: n_people + 1]
        drawn = [
            rng.permutation(np.flatnonzero(person == each))[: n_each + 1]
            for each in chosen
        ]
        gallery = np.concatenate([scans[:n_each] for scans in drawn[:-1]])
        query = drawn[-(number % 2)][n_each]
        apart, classes = distances[query, gallery], person[gallery]
        found = classes[apart.argmin()]
        nearest.append(apart.min())
        others.append(apart[classes != found].min())
        right.append(found == person[query])
    weights = np.where(np.arange(N_QUERIES) % 2, STRANGERS, 1.0)
    return Trials(features(np.array(nearest), np.array(others)), np.array(right), weights)


ANSWERS = Table(
    Column("sensor left out", 15, align="<"),
    Column("people", 6, "d"),
    Column("scans each", 10, "d"),
    *(Column(title, 7, ".3f") for title in ("nearest", "given")),
    Column("sure, wrong", 14),
    Column("strangers named", 15),
)

# Numbers of people in collections that are judged, and how many are drawn of each.
COLLECTIONS = (2, 5, 10, 25)
N_COLLECTIONS = 12


def _judged(
    sensors: Mapping[str, SensorScans], sample: Mapping[str, FloatArray]
) -> Iterator[str]:
    """Answers to scans by a sensor of which the reference knows nothing, neither of the people.

    Half of the people, by the other sensors, are the reference. Collections are of the other half.
    """
    yield ANSWERS.head
    for name, scans in sensors.items():
        others = [_half(each, 0) for other, each in sensors.items() if other != name]
        known = reference(others, sample)
        judged = _half(scans, 1)
        n_there = len(np.unique(judged.person))
        for n_people in (number for number in COLLECTIONS if number < n_there):
            for n_each in EACH:
                yield ANSWERS.row(
                    name,
                    n_people,
                    n_each,
                    *_answers(judged, n_people, n_each, known),
                )


def _half(scans: SensorScans, number: int) -> SensorScans:
    """The scans of every other person."""
    rows = scans.person % 2 == number
    return SensorScans(scans.points[rows], scans.person[rows])


def _answers(
    scans: SensorScans, n_people: int, n_each: int, known: Reference
) -> tuple[float, float, str, str]:
    """What is answered to scans of people in collections, and to scans of others.

    The shares of nearest that are right, and of these that are sure; how many are sure and wrong; and how
    many strangers get a name.
    """
    options = PipelineOptions()
    moments = people(options.signature)
    rng, found = np.random.default_rng(0), list[tuple[bool, bool, bool]]()
    several = np.flatnonzero(np.bincount(scans.person) > n_each)
    for _ in range(N_COLLECTIONS):
        drawn = [
            rng.permutation(np.flatnonzero(scans.person == one))[: n_each + 1]
            for one in rng.permutation(several)
        ]
        rows = np.concatenate([each[:n_each] for each in drawn[:n_people]])
        classes = scans.person[rows]
        table = SignatureTable(
            tuple(f"{row:06}" for row in range(len(rows))),
            scans.points[rows],
            options.signature.method,
            labels=tuple(map(str, classes)),
            metric=DESCRIPTORS[options.signature.method].metric,
        )
        whitening = table_whitening(table, options.retrieval, people=moments)
        scores = fit_scores(table, whitening, reference=known)
        if scores is None:
            raise TypeError("a reference must give scores to any labelled collection")
        places = whitening.apply(scans.points)
        for number, each in enumerate(drawn):
            apart = pairwise(options.retrieval.distance, places[each[-1:]], places[rows])[
                0
            ]
            label = classes[apart.argmin()]
            certainty = scores.certainty(apart.min(), apart[classes != label].min())
            is_right = bool(label == scans.person[each[-1]])
            is_sure = certainty is not None and certainty >= SURE
            found.append((number < n_people, is_right, is_sure))
    own, right, sure = np.array(found).T
    wrong = f"{(sure & own & ~right).sum()} of {own.sum()}"
    named = f"{(sure & ~own).sum()} of {(~own).sum()}"
    return right[own].mean(), sure[own & right].mean(), wrong, named


def _some(scans: Scans, chosen: Positions) -> Scans:
    """The scans of some people."""
    rows = np.isin(scans.person, chosen)
    person = np.unique(scans.person[rows], return_inverse=True)[1]
    parts = {name: part[rows] for name, part in scans.parts.items()}
    return Scans(parts, person, scans.ids[rows])


def _lines(
    scans: Scans, methods: Sequence[str], n_unseen: int | None, picture: Path | None
) -> Iterator[str]:
    n_people, sample = int(scans.person.max()) + 1, None
    curves: dict[str, FloatArray] = {}
    if n_unseen is not None:
        drawn = np.random.default_rng(0).permutation(n_people)
        sample = learned(_some(scans, drawn[:-n_unseen]))
        scans = _some(scans, drawn[-n_unseen:])
        yield f"learned from {n_people - n_unseen:,} other people"
    yield f"{len(scans.person):,} scans of {scans.person.max() + 1:,} people"
    yield TABLE.head
    for method in methods:
        for sized in (False, True):
            if sized and method == "hapt":
                continue
            options = SignatureOptions(method=method, size_weight=SIZE_WEIGHT * sized)
            points = fused_points(scans.parts, options)
            for kind in ("none", "neighbours", "people"):
                known = people(options, sample)
                whitening = fit_whitening(kind, points, people=known)
                found = recognition(whitening.apply(points), scans.person)
                compared = "form and size" if sized else "form"
                if kind == "people":
                    sizes = [row.people for row in found]
                    curves[f"{method}, {compared}"] = 1 - np.array(
                        [row.rank_1 for row in found]
                    )
                for row in found:
                    yield TABLE.row(method, compared, kind, *row)
    if picture is not None:
        y_label = "share of wrong people (1 − rank-1)"
        draw_curves(picture, sizes, curves, x_label="number of people", y_label=y_label)


def fused_points(
    parts: Mapping[str, FloatArray], options: SignatureOptions
) -> FloatArray:
    """The coordinates (n, L) of signatures by some options, of those of each part."""
    names = fused_names(options.method)
    scale = {name: DESCRIPTORS[name].spread if len(names) > 1 else 1.0 for name in names}
    columns = [
        parts[name][:, : {"r-bihdm": options.n_values}.get(name)] / scale[name]
        for name in names
    ]
    if options.size_weight:
        columns.append(options.size_weight * parts["size"])
    return np.concatenate(columns, axis=1)


class Row(NamedTuple):
    """How often the right person is found among so many; the rates of pairs do not depend on the number."""

    people: int
    rank_1: float
    rank_5: float
    equal_error: float
    missed: float
    fitted: str


# Share of pairs of two people that are accepted where the share of refused pairs of one person is stated.
ACCEPTED = 1e-3

# Number of queries whose distances are computed at once.
BLOCK = 256


def recognition(points: FloatArray, person: Positions) -> list[Row]:
    """The rows of a table of distances between whitened coordinates (n, L) of scans of people (n,)."""
    order = np.argsort(person, kind="stable")
    points, person = points[order], person[order]
    first = np.flatnonzero(np.diff(person, prepend=-1))  # the first scan of each person
    squares = (points**2).sum(axis=1)
    n_nearer, genuine, impostor = [], [], []
    for start in range(0, len(points), BLOCK):
        rows = np.arange(start, min(start + BLOCK, len(points)))
        # (q, n), squared.
        gaps = squares[rows, np.newaxis] + squares - 2 * points[rows] @ points.T
        gaps[rows - start, rows] = np.inf
        nearest = np.minimum.reduceat(gaps, first, axis=1)  # (q, people)
        own = nearest[rows - start, person[rows]]
        n_nearer.append((nearest < own[:, np.newaxis]).sum(axis=1))
        same = person[rows, np.newaxis] == person
        later = np.arange(len(points)) > rows[:, np.newaxis]
        genuine.append(gaps[same & later])
        impostor.append(gaps[~same & later].astype(np.float32))
    errors_of_pairs = verification(
        *(np.sort(np.concatenate(pairs)) for pairs in (genuine, impostor))
    )
    if errors_of_pairs is None:
        raise BenchmarkError(
            "the scans must be of two people or more, some person with two of them"
        )
    missed, equal = errors_of_pairs.missed(ACCEPTED), errors_of_pairs.equal_error
    curve = recognition_curve(np.concatenate(n_nearer), person, len(first))
    return [
        Row(
            point.n_classes,
            point.rank_1,
            point.rank_5,
            equal,
            missed,
            "fitted" if point.is_fitted else "",
        )
        for point in curve
        if point.n_classes >= min(SMALLEST, len(first))
    ]
