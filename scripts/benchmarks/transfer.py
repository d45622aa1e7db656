"""Print how the metric of people fares on a sensor that taught it nothing.

    scripts/make_people --out seen --people 700 --seed 1
    pcretrieve ingest seen --labels seen/labels.csv -c seen.sqlite
    scripts/make_people --out many --people 600 --seed 71 --poses 4 --sensors cameras uniform turntable steps
    pcretrieve ingest many --labels many/labels.csv -c many.sqlite
    scripts/benchmark transfer seen.sqlite many.sqlite                  # each kind of sensor left out once
    scripts/make_people --out bodies --people 200 --seed 48 --bodies
    scripts/benchmark transfer seen.sqlite many.sqlite --anny bodies    # the same of others
    scripts/benchmark transfer --anny bodies                            # by the metric of the package
    scripts/benchmark transfer --anny bodies --breath uneven            # breath and hair differ, too
    scripts/make_people --out haired --people 120 --poses 2 --seed 91 --bodies
    scripts/benchmark transfer seen.sqlite many.sqlite --anny bodies --haired haired
    scripts/benchmark transfer --damaged                               # people of another model

The people of the scans are cut into five folds. A metric that learned from four of them, without one kind of
sensor, ranks the scans of the fifth; queries are those by the kind that was left out, or those with a damage,
where all kinds taught. Scans of make_people without --sensors teach, and are in the galleries, but are no
queries. With --anny, people who taught nothing are scanned by sensors that taught nothing; "crossed" finds
each of their scans among those by all other sensors. Without catalogues, the metric is that of the package,
which all kinds of sensors taught, but not these people. With --haired, breath and hair of others teach, too.
"and size" is by `--size-weight 6`. FNMR is the share of pairs of one person that are refused where so many
pairs of two people are accepted.

A second table is of collections of one, two or three scans of each person: how often the nearest is right,
how many of the right answers are given, and how many strangers get a name: all others of these people, and
those of another model, `benchmarks.simulation`, by the same sensor.

With --damaged, ten people of `benchmarks.simulation` are scanned by uniform points. Scans with a gross fault
are queries in the whole scans of all other bodies, a collection to which the metric of the package adapts.
"""

from __future__ import annotations

import zlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import cache
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from benchmarks.bodies import Body, Mask, Sources, anny
from benchmarks.breath import breathing
from benchmarks.judging import examined, metric_of_people, moments_of_people
from benchmarks.measuring import (
    Column,
    Table,
    all_in_workers,
    argument_parser,
    print_lines,
)
from benchmarks.recognition import (
    N_FOLDS,
    N_HAIRED,
    SIZE_WEIGHT,
    Scans,
    damages_of,
    fused_points,
    haired,
    learned,
    reference,
    scans_of,
    some,
)
from benchmarks.sensors import DAMAGES, KINDS, SENSORS, WHOLE, left_by
from benchmarks.sets import SETS
from pcretrieve.descriptors import DESCRIPTORS
from pcretrieve.errors import BenchmarkError
from pcretrieve.evaluation.measures import verification
from pcretrieve.gallery.answers import SURE
from pcretrieve.options import PipelineOptions, RetrievalOptions, SignatureOptions
from pcretrieve.retrieval import (
    Positions,
    Whitening,
    fit_whitening,
    pairwise,
    table_whitening,
)
from pcretrieve.retrieval.people import People, Reference
from pcretrieve.retrieval.scores import fit_scores
from pcretrieve.values import FloatArray, PointCloud, SignatureTable

# The kind of sensor of make_people without --sensors.
RING = "ring"

# Kinds that have the same errors are left out together.
FAMILIES = {
    "cameras": ("cameras", RING),
    "uniform": ("uniform",),
    "depth": ("turntable", "steps"),
}

# The family of a sensor of benchmarks.sensors.
FAMILY_OF = {
    "nine": "cameras",
    "above": "cameras",
    "uniform": "uniform",
    "sparse": "uniform",
    "dense": "uniform",
    "turntable": "depth",
}

# Seed of scans, and of breath and hair.
SEED = 7

# Shares of pairs of two people that are accepted where FNMR is stated.
ACCEPTED = (1e-3, 1e-4)

TABLE = Table(
    Column("left out", 20, align="<"),
    Column("taught", 6, ",d"),
    Column("queries", 7, ",d"),
    *(Column(title, 8, ".4f") for title in ("rank-1", "EER")),
    *(Column(f"FNMR {rate:g}", 11, ".4f") for rate in ACCEPTED),
)

ANSWERS = Table(
    Column("sensor left out", 15, align="<"),
    Column("people", 6, "d"),
    Column("scans each", 10, "d"),
    *(Column(title, 7, ".3f") for title in ("nearest", "given")),
    Column("sure, wrong", 14),
    Column("strangers named", 15),
    Column("of another model", 16),
)

DAMAGED = Table(
    Column("damage", 11, align="<"),
    Column("queries", 7, ",d"),
    Column("rank-1", 8, ".4f"),
)

# Numbers of people in collections that are judged, of scans of each, and how many collections are drawn.
COLLECTIONS = (2, 5, 10, 25, 100)
EACH = (1, 2, 3)
N_COLLECTIONS = 12

# Whose scans are queries: people in the collection, others of the same model, and those of another.
GROUPS = ("own", "same model", "another")


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables."""
    parser = argument_parser(__doc__)
    parser.add_argument(
        "catalogues", nargs="*", type=Path, help="catalogues of people of make_people"
    )
    parser.add_argument(
        "--anny", type=Path, help="bodies of other people (make_people --bodies)"
    )
    parser.add_argument(
        "--limit", type=int, default=200, help="people of --anny (default: %(default)s)"
    )
    parser.add_argument(
        "--poses", type=int, default=3, help="scans of each (default: %(default)s)"
    )
    parser.add_argument(
        "--sensors",
        nargs="+",
        choices=SENSORS,
        default=["turntable", "uniform", "nine"],
        help="sensors of --anny",
    )
    parser.add_argument(
        "--breath",
        choices=("uneven", "styled"),
        help="with --anny: breath and hair are others in each scan; styled hair teaches no metric",
    )
    parser.add_argument(
        "--haired",
        type=Path,
        metavar="BODIES",
        help=f"with catalogues: add what breath and hair change in {N_HAIRED} of these",
    )
    parser.add_argument(
        "--damaged", action="store_true", help="scans with a gross fault, by the package"
    )
    given = parser.parse_args(arguments)
    if given.damaged:
        print_lines(lines_of_damages())
        return
    if not given.catalogues and not given.anny:
        parser.error("give catalogues, --anny, or --damaged")
    if given.breath and not given.anny:
        parser.error("--breath moves the bodies of --anny: give them, too")
    if given.haired and not given.catalogues:
        parser.error("--haired adds to what catalogues teach: give them, too")
    changed = haired(given.haired) if given.haired else 0.0
    scans = scans_of(given.catalogues) if given.catalogues else None
    if scans:
        print_lines(lines_of_kinds(scans, changed))
    if given.anny:
        unseen = {
            name: scans_by(
                name, given.anny, given.limit, given.poses, breath=given.breath
            )
            for name in given.sensors
        }
        others = {name: scans_of_another_model(name) for name in given.sensors}
        print_lines(lines_of_sensors(scans, unseen, others, changed))


def kinds_of(scans: Scans) -> NDArray[np.str_]:
    """(n,) the kinds of sensors in names of files of `make_people`."""
    return np.array(
        [
            next((kind for kind in KINDS if f"_{kind}_" in name), RING)
            for name in scans.ids.tolist()
        ]
    )


def without(scans: Scans, kinds: Collection[str], fold: int | None = None) -> Scans:
    """Scans by other kinds of sensors, of people of other folds; those of people with two of them."""
    rows = ~np.isin(kinds_of(scans), [*kinds])
    if fold is not None:
        rows &= scans.person % N_FOLDS != fold
    n_of = np.bincount(scans.person[rows], minlength=scans.person.max() + 1)
    return some(scans, rows & (n_of[scans.person] > 1))


class SensorScans(NamedTuple):
    """The default signature (n, L), log area (n,) and person (n,) of each of n scans by one sensor."""

    points: FloatArray
    sizes: FloatArray
    person: Positions

    def sized(self, weight: float) -> FloatArray:
        """The coordinates (n, L) of signatures with some weight of the size."""
        if not weight:
            return self.points
        return np.column_stack([self.points, weight * self.sizes])


def scans_by(
    sensor: str, bodies: Path, n_people: int, n_poses: int, *, breath: str | None
) -> SensorScans:
    """Scan people of Anny in some poses each by one sensor, and describe them.

    breath: how breath and hair differ between the scans; None: they do not.
    """
    people_of = anny(Sources(Path(), bodies, 0), n_people, n_poses)
    bodies_of = [body for poses in people_of for body in poses]
    if breath:
        bodies_of = breathing(bodies_of, SEED, is_styled=breath == "styled")
    done, points = _scanned(bodies_of, sensor, WHOLE)
    # Of all bodies: a person has one number, also where another sensor fails.
    person = np.unique([body.label for body in bodies_of], return_inverse=True)[1]
    return SensorScans(points[:, :-1], points[:, -1], person[done])


def scans_of_another_model(sensor: str) -> FloatArray:
    """(100, L) default signatures of ten people of `benchmarks.simulation` in ten poses, by one sensor."""
    return _scanned(_of_another_model(), sensor, WHOLE)[1][:, :-1]


@cache
def _of_another_model() -> list[Body]:
    items = SETS["humans"](Path(), None)
    return [Body(item.name, item.label, item.mesh) for item in items]


def _scanned(
    bodies: Sequence[Body], sensor: str, damage: str
) -> tuple[list[int], FloatArray]:
    """Which of some bodies have a surface when they are scanned, and what `_described` finds of these."""
    tasks = [(body, sensor, damage) for body in bodies]
    found = all_in_workers(_described, tasks, f"{sensor}, {damage}")
    done = [number for number, each in enumerate(found) if each is not None]
    return done, np.array([each for each in found if each is not None])


def _described(task: tuple[Body, str, str]) -> FloatArray | None:
    """The default signature of a damaged scan of a body, and its log area; None if it has no surface."""
    body, sensor, damage = task
    rng = np.random.default_rng((SEED, zlib.crc32(f"{body.name} {sensor}".encode())))
    points = SENSORS[sensor](body, rng)
    found, _ = examined(PointCloud(points[left_by(damage, points, body, rng)]))
    return np.append(found.point, np.log(found.area)) if found.point else None


class Found(NamedTuple):
    """Distances of queries to scans of their people, to those of others, and whether the nearest is right."""

    same: FloatArray
    apart: FloatArray
    right: FloatArray

    def rates(self) -> tuple[int | float, ...]:
        """The number of queries, rank-1, the equal error rate, and FNMR at `ACCEPTED`."""
        pairs = verification(np.sort(self.same), np.sort(self.apart))
        if pairs is None:
            raise BenchmarkError(
                f"each fold must have two people by each kind of sensor: give {10 * N_FOLDS} people"
            )
        missed = [pairs.missed(rate) for rate in ACCEPTED]
        return len(self.right), float(self.right.mean()), pairs.equal_error, *missed


def joined(found: Collection[Found]) -> Found:
    """The results of several rankings as one."""
    return Found(*(np.concatenate(part) for part in zip(*found, strict=True)))


def found_by(
    metric: Whitening,
    points: FloatArray,
    person: Positions,
    *,
    queries: Mask,
    sensor: NDArray[np.str_] | None = None,
) -> Found:
    """Compare queries, a mask (n,), with all scans; if sensors are given, with those by others only."""
    placed, found = metric.apply(points), [Found(*np.zeros((3, 0)))]
    for row in np.flatnonzero(queries):
        gaps = cdist(placed[row : row + 1], placed)[0]
        compared = np.arange(len(points)) != row
        if sensor is not None:
            compared &= sensor != sensor[row]
        is_own = person == person[row]
        own, strange = gaps[compared & is_own], gaps[compared & ~is_own]
        if not len(own) or not len(strange):
            continue
        right = np.array([own.min() < strange.min()], dtype=float)
        found.append(Found(own, strange, right))
    return joined(found)


def lines_of_kinds(scans: Scans, changed: FloatArray | float = 0.0) -> Iterator[str]:
    """The table by kinds of sensors that were left out, and by damages, of people who taught nothing.

    changed: as in `learned`.
    """
    points = fused_points(scans.parts, SignatureOptions())
    kind, damage = kinds_of(scans), damages_of(scans)
    asked = kind != RING
    groups = [
        (name, asked & np.isin(kind, kinds), kinds) for name, kinds in FAMILIES.items()
    ]
    groups += [(name, asked & (damage == name), ()) for name in (WHOLE, *DAMAGES)]
    groups = [group for group in groups if group[1].any()]
    metrics = {
        (kinds, fold): (
            metric_of_people(learned(teaching, changed)),
            len(teaching.person),
        )
        for kinds in {kinds for *_, kinds in groups}
        for fold in range(N_FOLDS)
        for teaching in [without(scans, kinds, fold)]
    }
    yield f"{len(points):,} scans of {scans.person.max() + 1:,} people"
    yield TABLE.head
    for name, queries, kinds in groups:
        found, n_taught = [], 0
        for fold in range(N_FOLDS):
            rows = scans.person % N_FOLDS == fold
            metric, n = metrics[kinds, fold]
            n_taught += n
            found.append(
                found_by(
                    metric,
                    points[rows],
                    scans.person[rows],
                    queries=queries[rows],
                )
            )
        yield TABLE.row(name, n_taught // N_FOLDS, *joined(found).rates())


def lines_of_sensors(
    scans: Scans | None,
    unseen: Mapping[str, SensorScans],
    others: Mapping[str, FloatArray],
    changed: FloatArray | float = 0.0,
) -> Iterator[str]:
    """The tables of people who taught nothing, by sensors that taught nothing; and crossed.

    scans: those that teach; without them, the metric is that of the package.
    others: signatures (m, L) of people of another model by each sensor, who are strangers to all.
    changed: as in `learned`.
    """
    taught, samples = dict[str, Scans](), dict[str, dict[str, FloatArray]]()
    if scans:
        taught = {name: without(scans, FAMILIES[FAMILY_OF[name]]) for name in unseen}
        samples = {name: learned(teaching, changed) for name, teaching in taught.items()}
    person = np.concatenate([each.person for each in unseen.values()])
    sensor = np.repeat([*unseen], [len(each.points) for each in unseen.values()])
    yield TABLE.head
    for weight in (0.0, SIZE_WEIGHT):
        points = np.concatenate([each.sized(weight) for each in unseen.values()])
        compared, across = " and size" * bool(weight), []
        for name, each in unseen.items():
            metric = metric_of_people(samples.get(name), weight)
            found = found_by(
                metric,
                each.sized(weight),
                each.person,
                queries=np.ones(len(each.person), dtype=bool),
            )
            n_taught = len(taught[name].person) if scans else None
            yield TABLE.row(f"{name}{compared}", n_taught, *found.rates())
            if len(unseen) > 1:
                queries = sensor == name
                across.append(
                    found_by(metric, points, person, queries=queries, sensor=sensor)
                )
        if across:
            yield TABLE.row(f"crossed{compared}", 0, *joined(across).rates())
    yield ""
    yield ANSWERS.head
    for name, each in unseen.items():
        moments = moments_of_people(samples.get(name))
        known = reference(taught[name], changed) if scans else moments.reference
        for n_people, n_each in product(COLLECTIONS, EACH):
            if n_people < (np.bincount(each.person) > n_each).sum():
                answers = answers_of(each, n_people, n_each, moments, known, others[name])
                yield ANSWERS.row(name, n_people, n_each, *answers)


def lines_of_damages() -> Iterator[str]:
    """The table of scans with a gross fault, in a collection with the metric of the package."""
    bodies = _of_another_model()
    labels = np.array([body.label for body in bodies])
    scanned = {
        damage: _scanned(bodies, "uniform", damage) for damage in (WHOLE, *DAMAGES)
    }
    whole, points = scanned[WHOLE]
    metric = fit_whitening(
        RetrievalOptions().whitening,
        points[:, :-1],
        labels[whole].tolist(),
        people=moments_of_people(),
    )
    collection = metric.apply(points[:, :-1])
    yield DAMAGED.head
    for damage, (done, points) in scanned.items():
        gaps = cdist(metric.apply(points[:, :-1]), collection)
        gaps[np.equal.outer(done, whole)] = np.inf
        right = labels[whole][gaps.argmin(axis=1)] == labels[done]
        yield DAMAGED.row(damage, len(bodies), right.sum() / len(bodies))


def answers_of(
    scans: SensorScans,
    n_people: int,
    n_each: int,
    moments: People,
    known: Reference | None,
    others: FloatArray,
) -> tuple[float, float, str, str, str]:
    """What is answered to scans of people in collections, to scans of others, and of another model.

    others: signatures (m, L) of people of another model.
    The shares of nearest that are right, and of these that are sure; how many are sure and wrong; and how
    many strangers get a name, of the same model and of another.
    """
    options = PipelineOptions()
    rng, found = np.random.default_rng(0), list[tuple[str, bool, bool]]()
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
        asked = [each[-1] for each in drawn]
        queries = np.concatenate([scans.points[asked], others])
        gaps = pairwise(
            options.retrieval.distance,
            whitening.apply(queries),
            whitening.apply(scans.points[rows]),
        )
        sizes = n_people, len(drawn) - n_people, len(others)
        groups = np.repeat(GROUPS, sizes).tolist()
        truth = [*scans.person[asked].tolist(), *[None] * len(others)]
        for group, person, apart in zip(groups, truth, gaps, strict=True):
            label = classes[apart.argmin()]
            certainty = scores.certainty(apart.min(), apart[classes != label].min())
            is_sure = certainty is not None and certainty >= SURE
            found.append((group, bool(label == person), is_sure))
    group = np.array([each[0] for each in found])
    right, sure = np.array([each[1:] for each in found]).T
    own, same_model, another = (group == one for one in GROUPS)
    wrong = f"{(sure & own & ~right).sum()} of {own.sum()}"
    named, foreign = (
        f"{(sure & strangers).sum()} of {strangers.sum()}"
        for strangers in (same_model, another)
    )
    return right[own].mean(), sure[own & right].mean(), wrong, named, foreign
