"""Print how the metric of people fares on a sensor that taught it nothing, and learn from several sensors.

    scripts/make_people --out many --people 600 --seed 71 --poses 4 --sensors cameras uniform turntable steps
    pcretrieve ingest many --labels many/labels.csv -c many.sqlite
    scripts/benchmark transfer many.sqlite                      # each kind of sensor left out once
    scripts/make_people --out bodies --people 200 --seed 48 --bodies
    scripts/benchmark transfer many.sqlite --anny bodies        # the same of others, by sensors of benchmarks
    scripts/benchmark transfer many.sqlite --learn --share .25  # writes pcretrieve/retrieval/people.npz
    scripts/benchmark people --refer bodies --limit 60 --sensors turntable uniform      # and what it means

Scans whose sensors, poses and damages were drawn at random scatter otherwise within people than those of nine
cameras. The covariance within people is a mixture of both, of which they have a share. What people differ by
does not depend on the sensor, so that the covariance between people stays. A share of 0 is the metric by nine
cameras alone; what the metric of the package has learned from drawn sensors is taken away from it before.

The people of the scans are cut into five folds. A metric that learned from four of them, without one kind of
sensor, ranks the scans of the fifth; queries are those by the kind that was left out, or those with a damage,
where all kinds taught. "crossed" finds each scan of other people among scans by all other sensors.

Where there are few people, the nearest scan is nearly always right. "of 1,000" is what rank-1 would be among
1,000 people, one scan of each, the coordinates of the others drawn by the moments of the package. It is an
estimate: real coordinates are not normal.

A scan whose grade says that a limb is missing is compared as it is, and as if each of three losses of a limb
were undone; the losses are the means of three groups of scans without a limb, relative to whole scans of the
same people. "limb, told" and so on are queries that are compared so.
"""

from __future__ import annotations

import io
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist
from sklearn.cluster import KMeans

import pcretrieve.retrieval
from benchmarks.bodies import Mask
from benchmarks.measuring import Column, Table, argument_parser, print_lines
from benchmarks.recognition import (
    ACCEPTED,
    Scans,
    SensorScans,
    fused_points,
    people_means,
    person_means,
    scans_by,
    scans_of,
    shrunk_within,
)
from benchmarks.sensors import DAMAGES, KINDS, SENSORS, WHOLE
from pcretrieve.errors import BenchmarkError
from pcretrieve.evaluation.measures import verification
from pcretrieve.options import SignatureOptions
from pcretrieve.retrieval import Positions, Whitening, fit_whitening, people
from pcretrieve.retrieval.people import SAMPLE
from pcretrieve.values import FloatArray
from pcretrieve.values.files import write_file

# Kinds that have the same errors are left out together.
FAMILIES = {
    "cameras": ("cameras",),
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
    Column("share", 5, ".2f"),
    Column("taught", 6, ",d"),
    Column("queries", 7, ",d"),
    *(Column(title, 8, ".4f") for title in ("rank-1", "of 1,000", "EER", "FNMR")),
)

# Number of kinds of losses. The smallest group moves as simulated people do without a head; which limbs the
# others lack was not looked at. With two, fewer find their person; with five, as many.
N_LOSSES = 3

# Number of strangers that are drawn, and of those among whom a person is looked for.
N_DRAWN, N_STRANGERS = 20_000, 999


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables, or learn."""
    parser = argument_parser(__doc__)
    parser.add_argument(
        "catalogues", nargs="+", type=Path, help="catalogues of make_people --sensors"
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
    parser.add_argument(
        "--share",
        nargs="+",
        type=float,
        default=[0.0, 0.25, 0.5, 0.75],
        help="shares of the drawn sensors (default: %(default)s)",
    )
    parser.add_argument(
        "--learn", action="store_true", help="write the metric of one share"
    )
    given = parser.parse_args(arguments)
    if given.learn and len(given.share) != 1:
        parser.error("--learn writes one metric: give one --share, such as .5")
    target = Path(pcretrieve.retrieval.__file__).with_name(SAMPLE)
    arrays = by_nine_cameras(np.load(target))
    scans = scans_of(given.catalogues)
    if given.learn:
        learned = mixed(arrays, scans, given.share[0])
        packed = io.BytesIO()
        whole = {name: array.astype(np.float32) for name, array in learned.items()}
        np.savez_compressed(packed, allow_pickle=False, **whole)
        write_file(target, packed.getvalue())
        return
    print_lines(lines_of_kinds(scans, arrays, given.share))
    if given.anny:
        unseen = {name: scans_by(name, given.anny, given.limit) for name in given.sensors}
        print_lines(lines_of_sensors(scans, unseen, arrays, given.share))


def kinds_of(ids: Sequence[str]) -> list[str]:
    """The kinds of sensors in names of files of `make_people --sensors`."""
    kinds = [next((kind for kind in KINDS if f"_{kind}_" in name), "") for name in ids]
    if not all(kinds):
        raise BenchmarkError(
            f"the scan {ids[kinds.index('')]} must have its sensor in its name: write scans with "
            "make_people --sensors"
        )
    return kinds


def by_nine_cameras(arrays: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """The arrays of `SAMPLE` without what drawn sensors have changed: for these, they have seen no sensor."""
    plain = {name: np.asarray(array, dtype=float) for name, array in arrays.items()}
    changed = plain.pop("drawn", 0.0)
    for name in ("within", "total"):
        plain[name] = plain[name] - changed
    return plain


def mixed(
    arrays: Mapping[str, FloatArray], scans: Scans, share: float
) -> dict[str, FloatArray]:
    """The arrays of `SAMPLE`, in whose covariance within people some scans have a share.

    arrays: as by `by_nine_cameras`.
    """
    points = np.concatenate(list(scans.parts.values()), axis=1) / arrays["scale"]
    own = shrunk_within(people_means(points, scans.person)[1])
    changed = share * (own - arrays["within"])
    moved = {name: arrays[name] + changed for name in ("within", "total")}
    return dict(arrays) | moved | {"drawn": changed, "losses": losses_of(points, scans)}


def losses_of(points: FloatArray, scans: Scans) -> FloatArray:
    """(K, 105) what the loss of a limb moves coordinates by, from the mean of whole scans of the person."""
    damage = damages_of(scans)
    is_whole = damage == WHOLE
    known, number = np.unique(scans.person[is_whole], return_inverse=True)
    means = person_means(points[is_whole], number)
    rows = (damage == "limb") & np.isin(scans.person, known)
    moved = points[rows] - means[np.searchsorted(known, scans.person[rows])]
    if len(moved) < N_LOSSES:
        return np.zeros((0, points.shape[1]))
    centres = KMeans(N_LOSSES, n_init=10, random_state=0).fit(moved).cluster_centers_
    return np.asarray(centres, dtype=np.float64)


def damages_of(scans: Scans) -> NDArray[np.str_]:
    """(n,) the damages in names of files of `make_people --sensors`."""
    return np.array([name.rpartition("_")[2] for name in scans.ids.tolist()])


def without(scans: Scans, kinds: Collection[str], fold: int | None = None) -> Scans:
    """Scans by other kinds of sensors, of people of other folds; those of people with two of them."""
    rows = ~np.isin(kinds_of(scans.ids.tolist()), [*kinds])
    if fold is not None:
        rows &= scans.person % N_FOLDS != fold
    rows &= (
        np.bincount(scans.person[rows], minlength=scans.person.max() + 1)[scans.person]
        > 1
    )
    person = np.unique(scans.person[rows], return_inverse=True)[1]
    parts = {name: part[rows] for name, part in scans.parts.items()}
    return Scans(parts, person, scans.ids[rows])


def metric_of(arrays: Mapping[str, FloatArray]) -> Whitening:
    """The whitening of people by the arrays of `SAMPLE`, for the default signature."""
    known = people(SignatureOptions(), arrays)
    if known is None:
        raise TypeError("the metric of people must be known for the default signature")
    return fit_whitening("people", known.mean[np.newaxis], people=known)


def strangers(arrays: Mapping[str, FloatArray]) -> FloatArray:
    """Coordinates (n, 68) of scans of people, drawn by the moments of the package."""
    known = people(SignatureOptions(), arrays)
    if known is None:
        raise TypeError("the metric of people must be known for the default signature")
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
    is_told: bool = False,
) -> Found:
    """Compare queries, a mask (n,), with all scans; if sensors are given, with those by others only.

    others: coordinates of strangers, (m, L).
    is_told: whether queries are known to lack a limb.
    """
    placed, drawn = metric.apply(points), metric.apply(others)
    losses = np.zeros((1, points.shape[1]))
    if is_told:
        losses = np.concatenate([losses, metric.losses])
    found = [Found(*np.zeros((4, 0)))]
    for row in np.flatnonzero(queries):
        completed = metric.apply(points[row] - losses)
        gaps = cdist(completed, placed).min(axis=0)
        compared = np.arange(len(points)) != row
        if sensor is not None:
            compared &= sensor != sensor[row]
        is_own = person == person[row]
        own, strange = gaps[compared & is_own], gaps[compared & ~is_own]
        if not len(own) or not len(strange):
            continue
        right = np.array([own.min() < strange.min()], dtype=float)
        nearer = np.mean(cdist(completed, drawn).min(axis=0) < own.min())
        found.append(Found(own, strange, right, np.array([(1 - nearer) ** N_STRANGERS])))
    return joined(found)


def lines_of_kinds(
    scans: Scans, arrays: Mapping[str, FloatArray], shares: Sequence[float]
) -> Iterator[str]:
    """The table by kinds of sensors that were left out, and by damages, of people who taught nothing."""
    points, drawn = fused_points(scans.parts, SignatureOptions()), strangers(arrays)
    kind = np.array(kinds_of(scans.ids.tolist()))
    damage = damages_of(scans)
    groups = [
        (name, np.isin(kind, kinds), kinds, False) for name, kinds in FAMILIES.items()
    ]
    groups += [(name, damage == name, (), False) for name in (WHOLE, *DAMAGES)]
    groups += [(f"{name}, told", damage == name, (), True) for name in DAMAGES]
    yield f"{len(points):,} scans of {scans.person.max() + 1:,} people"
    yield TABLE.head
    for name, queries, kinds, is_told in groups:
        for share in shares:
            found, n_taught = [], 0
            for fold in range(N_FOLDS):
                teaching = without(scans, kinds, fold)
                n_taught += len(teaching.person)
                rows = scans.person % N_FOLDS == fold
                metric = metric_of(mixed(arrays, teaching, share))
                found.append(
                    found_by(
                        metric,
                        points[rows],
                        scans.person[rows],
                        queries=queries[rows],
                        others=drawn,
                        is_told=is_told,
                    )
                )
            yield TABLE.row(name, share, n_taught // N_FOLDS, *joined(found).rates())


def lines_of_sensors(
    scans: Scans,
    unseen: Mapping[str, SensorScans],
    arrays: Mapping[str, FloatArray],
    shares: Sequence[float],
) -> Iterator[str]:
    """The table of people who taught nothing, by sensors that taught nothing; and crossed."""
    drawn = strangers(arrays)
    yield TABLE.head
    for name, each in unseen.items():
        for share in shares:
            teaching = without(scans, FAMILIES[FAMILY_OF[name]])
            metric = metric_of(mixed(arrays, teaching, share))
            every = np.ones(len(each.points), dtype=bool)
            found = found_by(
                metric, each.points, each.person, queries=every, others=drawn
            )
            yield TABLE.row(name, share, len(teaching.person), *found.rates())
    for share in shares if len(unseen) > 1 else ():
        found = crossed(scans, unseen, arrays, share, drawn)
        yield TABLE.row("crossed", share, 0, *found.rates())


def crossed(
    scans: Scans,
    unseen: Mapping[str, SensorScans],
    arrays: Mapping[str, FloatArray],
    share: float,
    others: FloatArray,
) -> Found:
    """Scans by each sensor among those by all others; the metric has not seen the sensor of the query."""
    points = np.concatenate([each.points for each in unseen.values()])
    person = np.concatenate([each.person for each in unseen.values()])
    sensor = np.repeat([*unseen], [len(each.points) for each in unseen.values()])
    found = []
    for name in unseen:
        metric = metric_of(
            mixed(arrays, without(scans, FAMILIES[FAMILY_OF[name]]), share)
        )
        found.append(
            found_by(
                metric,
                points,
                person,
                queries=sensor == name,
                others=others,
                sensor=sensor,
            )
        )
    return joined(found)
