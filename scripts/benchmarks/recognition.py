"""Print how often the right person is found among how many, and learn the metric of people.

    scripts/make_people --out seen --people 1500 --seed 1     # and others of other seeds
    pcretrieve ingest seen --labels seen/labels.csv -c seen.sqlite
    scripts/benchmark people seen.sqlite --unseen 1000        # learns from the others, and prints the curve
    scripts/make_people --out many --people 600 --seed 71 --poses 4 --sensors cameras uniform turntable steps
    pcretrieve ingest many --labels many/labels.csv -c many.sqlite
    scripts/make_people --out bodies --people 120 --seed 91 --poses 2 --bodies
    scripts/benchmark people seen.sqlite many.sqlite --learn --coarser others.sqlite --limbless 100 \
        --haired bodies

The last command writes pcretrieve/retrieval/people.npz: the moments of the scans, with what coarser meshes of
other scans, and missing limbs, breath and hair of other people change, and what distances of people mean who
did not teach the metric (see `reference`).

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
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import pcretrieve.retrieval
from benchmarks.bodies import Body, Sources, anny
from benchmarks.breath import breathing
from benchmarks.judging import metric_of_people
from benchmarks.measuring import (
    Column,
    Table,
    all_in_workers,
    argument_parser,
    draw_curves,
    print_lines,
)
from benchmarks.poses import POSES
from benchmarks.sensors import (
    DAMAGES,
    KINDS,
    N_TYPICAL,
    WHOLE,
    drawn,
    left_by,
    outer_points,
)
from benchmarks.sets import to_faces
from benchmarks.simulation import body, make_subject
from pcretrieve.catalogue import Catalogue
from pcretrieve.descriptors import DESCRIPTORS, describe
from pcretrieve.descriptors.hapt import RADII, WEIGHTS
from pcretrieve.errors import BenchmarkError, ShapeError
from pcretrieve.evaluation.measures import recognition_curve, verification
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
)
from pcretrieve.retrieval.people import (
    BEGINS,
    MOST_VALUES,
    N_VALUES,
    RATES,
    SAMPLE,
    SYMMETRIC,
    Reference,
)
from pcretrieve.retrieval.scores import (
    Trials,
    features,
    fitted_coefficients,
)
from pcretrieve.values import FloatArray, PointCloud, Shape
from pcretrieve.values.files import write_file

# The smallest collection of the curve, and the weight of the size: that of a body scanner.
SMALLEST = 100
SIZE_WEIGHT = PipelineOptions.of("body-scanner").signature.size_weight

# Those of hapt, of r-bihdm and the size.
N_COORDINATES = BEGINS["r-bihdm"] + MOST_VALUES + 1

TABLE = Table(
    Column("method", 13, align="<"),
    Column("compared", 14, align="<"),
    Column("whitening", 10, align="<"),
    Column("people", 7, ",d"),
    *(Column(title, 7, ".4f") for title in ("rank-1", "rank-5", "EER", "FNMR")),
    Column("", 7, align="<"),
)


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
        "catalogues", nargs="+", type=Path, help="catalogues of labelled scans of people"
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
        nargs="+",
        type=Path,
        default=(),
        metavar="CATALOGUE",
        help="with --learn: add what coarser meshes of these scans change",
    )
    parser.add_argument(
        "--limbless",
        type=int,
        default=0,
        metavar="N",
        help="with --learn: add what a missing limb changes in scans of N simulated people",
    )
    parser.add_argument(
        "--haired",
        type=Path,
        metavar="BODIES",
        help=f"with --learn: add what breath and hair change in {N_HAIRED} of these (make_people --bodies)",
    )
    parser.add_argument(
        "--methods", nargs="+", default=["hapt+r-bihdm", "hapt", "r-bihdm"]
    )
    parser.add_argument("--draw", type=Path, metavar="PICTURE", help="draw the curve")
    given = parser.parse_args(arguments)
    if (given.coarser or given.limbless or given.haired) and not given.learn:
        parser.error(
            "--coarser, --limbless and --haired add to what --learn learns: give it, too"
        )
    scans = scans_of(given.catalogues)
    if given.learn:
        lost = np.zeros((N_COORDINATES, N_COORDINATES))
        if given.limbless:
            lost = limbless(given.limbless)
        changed = SHARE_OF_LIMBS * lost
        if given.coarser:
            changed += coarser(given.coarser)
        if given.haired:
            changed += haired(given.haired)
        sample = learned(scans, changed) | reference(scans, changed)._asdict()
        sample["limbs"] = limbs_of(lost / np.outer(sample["scale"], sample["scale"]))
        sample |= limbless_moments(scans, sample["scale"])
        written = io.BytesIO()
        np.savez_compressed(written, allow_pickle=False, **packed(sample))
        target = Path(pcretrieve.retrieval.__file__).with_name(SAMPLE)
        write_file(target, written.getvalue())
    else:
        print_lines(_lines(scans, given.methods, given.unseen, given.draw))


def packed(sample: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """The arrays of `SAMPLE` as they are stored: float32, and the upper triangles of symmetric matrices."""
    triangles = {
        name: sample[name][np.triu_indices(len(sample[name]))] for name in SYMMETRIC
    }
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

# How often a hard scan counts within people: a damaged one, or one of somebody who sits, because bellies lie
# on thighs, which hides up to an eighth of the surface. See docs/decisions.md, drawn sensors.
HARD = 3.0

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


def learned(scans: Scans, changed: FloatArray | float = 0.0) -> dict[str, FloatArray]:
    """The moments of `SAMPLE`.

    changed: (214, 214) what is added to the covariance within people: shares of `coarser`, `limbless` and
    `haired`.
    """
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
    sits = np.char.find(scans.ids, "_sit") >= 0
    counted = np.where(sits | (damages_of(scans) != WHOLE), HARD, 1.0)
    apart = points / unit - means[scans.person]
    n_free = counted.mean() * (len(points) - len(means))
    within = (counted * apart.T) @ apart / n_free
    shrunk = shrunk_within(within)
    # The covariance between people without that of the means of a few scans.
    between = np.cov(means.T) - within * (1 / n_of).mean()
    weights, directions = np.linalg.eigh(between)
    between = (directions * np.maximum(weights, 0)) @ directions.T
    units = np.outer(unit, unit)
    within = units * shrunk + changed / np.outer(scale, scale)
    return {
        "mean": points.mean(axis=0),
        "within": within,
        "total": within + units * between,
        "limbs": np.zeros((len(scale), N_LIMBS)),
        "scale": scale,
    }


# Numbers of faces of the coarser meshes, and the share of what they change in the covariance within people:
# see docs/decisions.md, coarser.
N_FACES, COARSER = (1000, 2000, 3000), 0.25

# The share of what a missing limb changes in the covariance within people, and the number of directions that
# are stored: see docs/decisions.md, limbless.
SHARE_OF_LIMBS, N_LIMBS = 0.05, 12

# The share of what breath and hair change in the covariance within people, of how many people in how many
# poses, and the seed of their hair: see docs/decisions.md, haired.
SHARE_OF_HAIR, N_HAIRED, HAIRED_POSES, HAIR_SEED = 0.2, 120, 2, 91

# The number of the first person without a limb: no other benchmark has these.
FIRST_LIMBLESS = 2000


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
    return COARSER * _second_moment(all_in_workers(_coarser, tasks, "coarser"))


def limbless(n_people: int) -> FloatArray:
    """(214, 214) the second moment of what a missing limb, or head, changes in a scan.

    The people are those of `benchmarks.simulation`: limbs that are missing from bodies of one model, those of
    make_people, teach too little of others.
    """
    people_of = range(FIRST_LIMBLESS, FIRST_LIMBLESS + n_people)
    return _second_moment(all_in_workers(_limbless, people_of, "limbs"))


def haired(folder: Path) -> FloatArray:
    """(214, 214) the share of the second moment of what breath and hair change in people of Anny.

    The points lie on the surfaces: no sensor teaches here.
    """
    people_of = anny(Sources(Path(), folder, 0), N_HAIRED, HAIRED_POSES)
    plain = [body for poses in people_of for body in poses]
    tasks = list(zip(plain, breathing(plain, HAIR_SEED), strict=True))
    return SHARE_OF_HAIR * _second_moment(all_in_workers(_haired, tasks, "hair"))


def limbs_of(moment: FloatArray) -> FloatArray:
    """(214, 12) the directions of a second moment, each as long as its root there, the largest last."""
    squares, directions = np.linalg.eigh(moment)
    largest = np.sqrt(squares[-N_LIMBS:].clip(0))
    return np.asarray(directions[:, -N_LIMBS:] * largest)


def limbless_moments(scans: Scans, scale: FloatArray) -> dict[str, FloatArray]:
    """The moments of scans without the end of a limb, or the head, by the first values of R-BiHDM.

    scale: (214,) of the coordinates.
    """
    begin = BEGINS["r-bihdm"]
    points = scans.parts["r-bihdm"] / scale[begin : begin + MOST_VALUES]
    found = points[damages_of(scans) == "limb", :N_VALUES]
    return {"limbless_mean": found.mean(axis=0), "limbless": np.cov(found.T)}


def _second_moment(changes: Sequence[FloatArray | None]) -> FloatArray:
    known = np.array([change for change in changes if change is not None])
    return np.asarray(known.T @ known / len(known))


def _coarser(task: tuple[Path, str, int]) -> FloatArray | None:
    """(214,) what the coordinates change by if the mesh of a scan has so many faces; None if it fails."""
    path, shape_id, n_faces = task
    options = PipelineOptions().changed(surface={"mode": "keep"})
    with Catalogue(path) as catalogue:
        fine = catalogue.shape(shape_id)
    try:
        coarse = process(to_faces(n_faces, fine.mesh), options)
    except ShapeError:
        return None
    return _coordinates(coarse) - _coordinates(fine)


def _limbless(number: int) -> FloatArray | None:
    """(214,) what the coordinates of a scan of somebody change by without a limb; None if it fails."""
    rng = np.random.default_rng((number, 0))
    subject = make_subject("person", np.random.default_rng(number))
    pose, kind = rng.choice(sorted(POSES["person"])), str(rng.choice(KINDS))
    one = Body(str(number), str(number), body(subject, POSES["person"][pose], rng))
    points = drawn(kind, one, rng)
    kept = left_by("limb", points, one, rng)
    try:
        whole, cut = (process(PointCloud(each)) for each in (points, points[kept]))
    except ShapeError:
        return None
    return _coordinates(cut) - _coordinates(whole)


def _haired(task: tuple[Body, Body]) -> FloatArray | None:
    """(214,) what the coordinates differ by between two surfaces of one topology; None if one fails."""
    points = (
        outer_points(each.mesh, N_TYPICAL, np.random.default_rng(0))[0] for each in task
    )
    try:
        plain, moved = (process(PointCloud(each)) for each in points)
    except ShapeError:
        return None
    return _coordinates(moved) - _coordinates(plain)


def _coordinates(shape: Shape) -> FloatArray:
    """(214,) the coordinates of the three parts of a signature."""
    made = [
        describe(shape, SignatureOptions(method=method, n_values=59)) for method in BEGINS
    ]
    parts = [coordinates(one.values, one.metric) for one in made]
    return np.concatenate([*parts, [np.log(shape.area)]])


# Number of parts into which people are cut, each of which is judged by a metric that the others taught.
N_FOLDS = 5

# Numbers of people, and of scans of each, in galleries of which a query is drawn, and how many queries of
# each are drawn from each fold.
GALLERIES = (3, 10, 30, 100)
EACH = (1, 2)
N_QUERIES = 600

# Weight of a query whose person is not in the gallery: a collection that has hardly any statistics of its own
# should name no stranger. See docs/decisions.md, one scan each.
STRANGERS = 100.0

# Number of quantiles of the distances of scans of one person.
N_SAME = 201


def reference(scans: Scans, changed: FloatArray | float = 0.0) -> Reference:
    """What distances of whole scans mean, by metrics that the people of four folds taught, of the fifth.

    changed: as in `learned`. A metric knows the people who taught it, and they would seem too different.
    """
    same, apart, tried = list[FloatArray](), list[FloatArray](), list[Trials]()
    rng = np.random.default_rng(0)
    for fold in range(N_FOLDS):
        is_judged = scans.person % N_FOLDS == fold
        metric = metric_of_people(learned(some(scans, ~is_judged), changed))
        judged = some(scans, is_judged & (damages_of(scans) == WHOLE))
        person = judged.person
        points = metric.apply(fused_points(judged.parts, SignatureOptions()))
        distances = pairwise(RetrievalOptions().distance, points, points)
        first, second = np.triu_indices(len(points), k=1)
        is_same = person[first] == person[second]
        same.append(distances[first, second][is_same])
        apart.append(distances[first, second][~is_same])
        tried += [
            _drawn(distances, person, n_people, n_each, rng)
            for n_people, n_each in product(GALLERIES, EACH)
            if n_people < (np.bincount(person) > n_each).sum()
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


def some(scans: Scans, rows: NDArray[np.bool_]) -> Scans:
    """Some of the scans, whose people are numbered anew."""
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
        is_unseen = np.isin(scans.person, drawn[-n_unseen:])
        sample, scans = learned(some(scans, ~is_unseen)), some(scans, is_unseen)
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
