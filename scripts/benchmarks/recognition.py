"""Print how often the right person is found among how many, and learn the metric of people.

    scripts/make_people --out seen --people 1500 --seed 1     # and others of other seeds
    pcretrieve ingest seen --labels seen/labels.csv -c seen.sqlite
    scripts/benchmark people seen.sqlite --unseen 1000        # learns from the others, and prints the curve
    scripts/benchmark people seen.sqlite --learn              # writes pcretrieve/retrieval/people.npz
    scripts/benchmark people others.sqlite --coarser          # adds what coarser meshes of scans change

Each scan is a query in all other scans. Rank-1 is the share of queries whose nearest scan is of the same
person; rank-5, of which one of the nearest five people is this person. They are the expected values over all
galleries of n of the people, of which none is drawn. Pairs of scans are of one person or of two: the equal
error rate (EER) is where the shares of wrong answers are the same for both, and FNMR the share of pairs of
one person that are refused where one in a thousand pairs of two people is accepted. Beyond the people that
there are, 1 − rank-1 is continued as a power of n; these rows are marked as fitted. "form and size" is by
`--size-weight 6`.

The metric is learned by the covariances within and between people, and a network, in the space of this
metric, by what one scan of a person tells of the mean of the others: see `pcretrieve.retrieval.people`.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.stats import hypergeom
from sklearn.neural_network import MLPRegressor

import pcretrieve.retrieval
from benchmarks.measuring import (
    Column,
    Table,
    all_in_workers,
    argument_parser,
    draw_curves,
    print_lines,
)
from benchmarks.sets import to_faces
from pcretrieve.catalogue import Catalogue
from pcretrieve.descriptors import DESCRIPTORS, describe
from pcretrieve.errors import BenchmarkError, ShapeError
from pcretrieve.evaluation.measures import verification
from pcretrieve.gallery.fitted import signatures
from pcretrieve.options import PipelineOptions, SignatureOptions, fused_names
from pcretrieve.pipeline.process import process
from pcretrieve.retrieval import Positions, coordinates, fit_whitening, people
from pcretrieve.retrieval.people import BEGINS, SAMPLE
from pcretrieve.values import FloatArray
from pcretrieve.values.files import write_file

SIZES = (100, 300, 1000, 3000, 10_000)

# The smallest gallery that the power of n is fitted to, and the weight of the size: that of a body scanner.
FITTED_FROM = 100
SIZE_WEIGHT = PipelineOptions.of("body-scanner").signature.size_weight

TABLE = Table(
    Column("method", 13, align="<"),
    Column("compared", 14, align="<"),
    Column("whitening", 10, align="<"),
    Column("people", 7, ",d"),
    *(Column(title, 7, ".4f") for title in ("rank-1", "rank-5", "EER", "FNMR")),
    Column("", 7, align="<"),
)


class Scans(NamedTuple):
    """Coordinates of the three parts (n, 45), (n, 59), (n, 1), and the person (n,) of each of n scans."""

    parts: dict[str, FloatArray]
    person: Positions


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
        action="store_true",
        help="add what coarser meshes of the scans change",
    )
    parser.add_argument(
        "--methods", nargs="+", default=["hapt+r-bihdm", "hapt", "r-bihdm"]
    )
    parser.add_argument("--draw", type=Path, metavar="PICTURE", help="draw the curve")
    given = parser.parse_args(arguments)
    target = Path(pcretrieve.retrieval.__file__).with_name(SAMPLE)
    if given.learn or given.coarser:
        arrays = (
            learned(scans_of(given.catalogues)) if given.learn else dict(np.load(target))
        )
        if given.coarser:
            changed = coarser(given.catalogues) / np.outer(
                arrays["scale"], arrays["scale"]
            )
            arrays |= {
                name: (arrays[name] + changed).astype(np.float32)
                for name in ("within", "total")
            }
        packed = io.BytesIO()
        np.savez_compressed(packed, allow_pickle=False, **arrays)
        write_file(target, packed.getvalue())
    else:
        print_lines(
            _lines(scans_of(given.catalogues), given.methods, given.unseen, given.draw)
        )


def scans_of(catalogues: Sequence[Path]) -> Scans:
    """The coordinates of all scans of some catalogues, of which no two have a person in common."""
    parts: dict[str, list[FloatArray]] = {"hapt": [], "r-bihdm": [], "size": []}
    labels: list[str] = []
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
    person = np.unique(labels, return_inverse=True)[1]
    return Scans({name: np.concatenate(blocks) for name, blocks in parts.items()}, person)


# Shrinkage of the covariance within people towards its own diagonal, and least variance within people
# relative to the mean: some bins of hapt are empty for nearly all people.
SHRINKAGE, LEAST = 0.03, 1e-3


def learned(scans: Scans) -> dict[str, FloatArray]:
    """The arrays of `SAMPLE`."""
    scale = np.array(
        [DESCRIPTORS[name].spread if name in BEGINS else 1.0 for name in scans.parts]
    )
    scale = np.repeat(scale, [part.shape[1] for part in scans.parts.values()])
    points = np.concatenate(list(scans.parts.values()), axis=1) / scale
    n_of = np.bincount(scans.person)
    means = (
        np.stack([np.bincount(scans.person, column) for column in points.T], axis=1)
        / n_of[:, None]
    )
    apart = points - means[scans.person]
    within = apart.T @ apart / (len(points) - len(n_of))
    variances = np.diag(within)
    floor = LEAST * variances.mean() * np.eye(len(within))
    shrunk = (1 - SHRINKAGE) * within + SHRINKAGE * np.diag(variances) + floor
    # The covariance between people without that of the means of a few scans.
    between = np.cov(means.T) - within * (1 / n_of).mean()
    weights, directions = np.linalg.eigh(between)
    between = (directions * np.maximum(weights, 0)) @ directions.T
    moments = {
        "mean": points.mean(axis=0),
        "within": shrunk,
        "total": shrunk + between,
        "scale": scale,
    }
    moments["network"] = _network(scans, moments)
    return {name: array.astype(np.float32) for name, array in moments.items()}


# Numbers of faces of the coarser meshes, and the share of what they change in the covariance within people:
# see docs/decisions.md, coarser.
N_FACES, COARSER = (1000, 2000, 3000), 0.25


def coarser(catalogues: Sequence[Path]) -> FloatArray:
    """(105, 105) the share of the second moment of what coarser meshes of stored scans change."""
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
    """(105,) what the coordinates change by if the mesh of a scan has so many faces; None if it fails."""
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


# Number of hidden units, and weight decay. A layer of 128 units is no worse than two of 256 and 128; a decay
# of .3 or 5 gives a rank-1 among 10,000 people, fitted, of .972 or .968, not .970.
N_HIDDEN, DECAY = 128, 1.0

# Least weight of a direction that the network changes, relative to the largest.
LEAST_WEIGHT = 0.003


def _network(scans: Scans, moments: Mapping[str, FloatArray]) -> FloatArray:
    """The network of `pcretrieve.retrieval.people.corrected`."""
    options = SignatureOptions()
    points = fused_points(scans.parts, options)
    whitening = fit_whitening("people", points, people=people(options, moments))
    whitened = whitening.apply(points)
    n_of = np.bincount(scans.person)
    sums = np.stack([np.bincount(scans.person, column) for column in whitened.T], axis=1)
    known = n_of[scans.person] > 1
    own, person = whitened[known], scans.person[known]
    others = (sums[person] - own) / (n_of[person] - 1)[:, np.newaxis]
    unit = own.std()
    network = MLPRegressor(
        hidden_layer_sizes=(N_HIDDEN,),
        alpha=DECAY,
        early_stopping=True,
        n_iter_no_change=15,
        max_iter=500,
        random_state=0,
    )
    network.fit(own / unit, others / unit)
    (first, last), (bias, shift) = network.coefs_, network.intercepts_
    back = unit * np.linalg.pinv(whitening.matrix, rcond=LEAST_WEIGHT, hermitian=True)
    first, last, shift = (
        whitening.matrix @ first / unit,
        last @ back,
        whitening.mean + shift @ back,
    )
    # The shift is the output of one more unit, which is always 1.
    first, bias = (
        np.column_stack([first, np.zeros(len(first))]),
        np.append(bias - whitening.mean @ first, 1.0),
    )
    return np.concatenate([first, [bias], np.column_stack([last.T, shift])])


def _some(scans: Scans, chosen: Positions) -> Scans:
    """The scans of some people."""
    rows = np.isin(scans.person, chosen)
    person = np.unique(scans.person[rows], return_inverse=True)[1]
    return Scans({name: part[rows] for name, part in scans.parts.items()}, person)


def _lines(
    scans: Scans, methods: Sequence[str], n_unseen: int | None, picture: Path | None
) -> Iterator[str]:
    n_people, arrays = int(scans.person.max()) + 1, None
    curves: dict[str, FloatArray] = {}
    if n_unseen is not None:
        drawn = np.random.default_rng(0).permutation(n_people)
        arrays = learned(_some(scans, drawn[:-n_unseen]))
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
                known = people(options, arrays)
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

# Number of queries whose distances are computed at once, and the least error, of which a logarithm is taken.
BLOCK, TINY = 256, 1e-9


def recognition(points: FloatArray, person: Positions) -> list[Row]:
    """The rows of a table of distances between whitened coordinates (n, L) of scans of people (n,)."""
    order = np.argsort(person, kind="stable")
    points, person = points[order], person[order]
    first = np.flatnonzero(np.diff(person, prepend=-1))  # the first scan of each person
    squares = (points**2).sum(axis=1)
    n_nearer, genuine, impostor = [], [], []
    for start in range(0, len(points), BLOCK):
        rows = np.arange(start, min(start + BLOCK, len(points)))
        gaps = (
            squares[rows, np.newaxis] + squares - 2 * points[rows] @ points.T
        )  # (q, n), squared
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
    nearer, n_people = np.concatenate(n_nearer), len(first)
    known = [size for size in SIZES if size < n_people] + [n_people]
    # Of the people who are nearer than the query's own scans, how many are in a random gallery.
    rates = np.array(
        [
            [np.mean(hypergeom.cdf(r - 1, n_people - 1, nearer, n - 1)) for r in (1, 5)]
            for n in known
        ]
    )
    used = np.array(known) >= FITTED_FROM
    beyond = [size for size in SIZES if size > n_people] if used.sum() > 1 else []
    errors = np.log(np.maximum(1 - rates[used, 0], TINY))
    slope, level = (
        np.polyfit(np.log(np.array(known)[used]), errors, 1) if beyond else (0.0, 0.0)
    )
    fitted = [
        [max(0.0, 1 - np.exp(slope * np.log(size) + level)), np.nan] for size in beyond
    ]
    rates = np.concatenate([rates, np.reshape(fitted, (-1, 2))])
    sizes = known + beyond
    return [
        Row(size, rank_1, rank_5, equal, missed, "fitted" if size > n_people else "")
        for size, (rank_1, rank_5) in zip(sizes, rates.tolist(), strict=True)
    ]
