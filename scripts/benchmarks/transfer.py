"""Print how the metric of people fares on a sensor that taught it nothing.

    scripts/make_people --out seen --people 700 --seed 1
    pcretrieve ingest seen --labels seen/labels.csv -c seen.sqlite
    scripts/make_people --out many --people 600 --seed 71 --poses 4 --sensors cameras uniform turntable steps
    pcretrieve ingest many --labels many/labels.csv -c many.sqlite
    scripts/benchmark transfer seen.sqlite many.sqlite                  # each kind of sensor left out once
    scripts/make_people --out bodies --people 200 --seed 48 --bodies
    scripts/benchmark transfer seen.sqlite many.sqlite --anny bodies    # the same of others

The people of the scans are cut into five folds. A metric that learned from four of them, without one kind of
sensor, ranks the scans of the fifth; queries are those by the kind that was left out, or those with a damage,
where all kinds taught. Scans of make_people without --sensors teach, and are in the galleries, but are no
queries. With --anny, people who taught nothing are scanned by sensors that taught nothing; "crossed" finds
each of their scans among those by all other sensors.

Where there are few people, the nearest scan is nearly always right. "of 1,000" is what rank-1 would be among
1,000 people, one scan of each, the coordinates of the others drawn by the moments of the package. It is an
estimate: real coordinates are not normal.

"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from benchmarks.bodies import Mask
from benchmarks.judging import metric_of_people, moments_of_people
from benchmarks.measuring import Column, Table, argument_parser, print_lines
from benchmarks.recognition import (
    ACCEPTED,
    Scans,
    SensorScans,
    damages_of,
    fused_points,
    learned,
    scans_by,
    scans_of,
)
from benchmarks.sensors import DAMAGES, KINDS, SENSORS, WHOLE
from pcretrieve.errors import BenchmarkError
from pcretrieve.evaluation.measures import verification
from pcretrieve.options import SignatureOptions
from pcretrieve.retrieval import Positions, Whitening
from pcretrieve.values import FloatArray

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

N_FOLDS = 5

TABLE = Table(
    Column("left out", 11, align="<"),
    Column("taught", 6, ",d"),
    Column("queries", 7, ",d"),
    *(Column(title, 8, ".4f") for title in ("rank-1", "of 1,000", "EER", "FNMR")),
)

# Number of strangers that are drawn, and of those among whom a person is looked for.
N_DRAWN, N_STRANGERS = 20_000, 999


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables."""
    parser = argument_parser(__doc__)
    parser.add_argument(
        "catalogues", nargs="+", type=Path, help="catalogues of people of make_people"
    )
    parser.add_argument(
        "--anny", type=Path, help="bodies of other people (make_people --bodies)"
    )
    parser.add_argument(
        "--limit", type=int, default=200, help="people of --anny (default: %(default)s)"
    )
    parser.add_argument(
        "--sensors",
        nargs="+",
        choices=SENSORS,
        default=["turntable", "uniform", "nine"],
        help="sensors of --anny",
    )
    given = parser.parse_args(arguments)
    scans = scans_of(given.catalogues)
    print_lines(lines_of_kinds(scans))
    if given.anny:
        unseen = {name: scans_by(name, given.anny, given.limit) for name in given.sensors}
        print_lines(lines_of_sensors(scans, unseen))


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
    rows &= (
        np.bincount(scans.person[rows], minlength=scans.person.max() + 1)[scans.person]
        > 1
    )
    person = np.unique(scans.person[rows], return_inverse=True)[1]
    parts = {name: part[rows] for name, part in scans.parts.items()}
    return Scans(parts, person, scans.ids[rows])


def strangers() -> FloatArray:
    """Coordinates (n, L) of scans of people, drawn by the moments of the package."""
    known = moments_of_people()
    drawn = np.random.default_rng(0).standard_normal((N_DRAWN, len(known.mean)))
    return np.asarray(known.mean + drawn @ np.linalg.cholesky(known.total).T)


class Found(NamedTuple):
    """Distances of queries to scans of their people, to those of others, and whether the nearest is right.

    among: (q,) the probabilities that it is among so many strangers.
    """

    same: FloatArray
    apart: FloatArray
    right: FloatArray
    among: FloatArray

    def rates(self) -> tuple[int, float, float, float, float]:
        """The number of queries, rank-1, that of 1,000, the equal error rate and FNMR."""
        pairs = verification(np.sort(self.same), np.sort(self.apart))
        if pairs is None:
            raise BenchmarkError(
                f"each fold must have two people by each kind of sensor: give {10 * N_FOLDS} people"
            )
        right, among = float(self.right.mean()), float(self.among.mean())
        return len(self.right), right, among, pairs.equal_error, pairs.missed(ACCEPTED)


def joined(found: Collection[Found]) -> Found:
    """The results of several rankings as one."""
    return Found(*(np.concatenate(part) for part in zip(*found, strict=True)))


def found_by(
    metric: Whitening,
    points: FloatArray,
    person: Positions,
    *,
    queries: Mask,
    others: FloatArray,
    sensor: NDArray[np.str_] | None = None,
) -> Found:
    """Compare queries, a mask (n,), with all scans; if sensors are given, with those by others only.

    others: coordinates of strangers, (m, L).
    """
    placed, drawn = metric.apply(points), metric.apply(others)
    found = [Found(*np.zeros((4, 0)))]
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
        nearer = np.mean(cdist(placed[row : row + 1], drawn)[0] < own.min())
        found.append(Found(own, strange, right, np.array([(1 - nearer) ** N_STRANGERS])))
    return joined(found)


def lines_of_kinds(scans: Scans) -> Iterator[str]:
    """The table by kinds of sensors that were left out, and by damages, of people who taught nothing."""
    points, drawn = fused_points(scans.parts, SignatureOptions()), strangers()
    kind, damage = kinds_of(scans), damages_of(scans)
    groups = [(name, np.isin(kind, kinds), kinds) for name, kinds in FAMILIES.items()]
    groups += [(name, damage == name, ()) for name in (WHOLE, *DAMAGES)]
    metrics = {
        (kinds, fold): (metric_of_people(learned(teaching)), len(teaching.person))
        for kinds in ((), *FAMILIES.values())
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
                    queries=(queries & (kind != RING))[rows],
                    others=drawn,
                )
            )
        yield TABLE.row(name, n_taught // N_FOLDS, *joined(found).rates())


def lines_of_sensors(scans: Scans, unseen: Mapping[str, SensorScans]) -> Iterator[str]:
    """The table of people who taught nothing, by sensors that taught nothing; and crossed."""
    points = np.concatenate([each.points for each in unseen.values()])
    person = np.concatenate([each.person for each in unseen.values()])
    sensor = np.repeat([*unseen], [len(each.points) for each in unseen.values()])
    drawn, across = strangers(), []
    yield TABLE.head
    for name, each in unseen.items():
        teaching = without(scans, FAMILIES[FAMILY_OF[name]])
        metric = metric_of_people(learned(teaching))
        every = np.ones(len(each.points), dtype=bool)
        found = found_by(metric, each.points, each.person, queries=every, others=drawn)
        yield TABLE.row(name, len(teaching.person), *found.rates())
        if len(unseen) > 1:
            queries = sensor == name
            across.append(
                found_by(
                    metric, points, person, queries=queries, others=drawn, sensor=sensor
                )
            )
    if across:
        yield TABLE.row("crossed", 0, *joined(across).rates())
