"""Print what is measured of scans as sensors make them: unseen bases, leaks of the flood fill, real files.

    .venv/bin/python scripts/benchmark_sensors --data FOLDER

needs the sets `stanford_bunny` and `stanford_dragon` in the folder; parts whose set is missing are left out,
with a line of output. One core. About six minutes on a 2.5 GHz Xeon.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from pcretrieve.benchmarks.arguments import add_data, argument_parser, positive
from pcretrieve.benchmarks.progress import progress
from pcretrieve.benchmarks.sets import left_out, spread
from pcretrieve.benchmarks.tables import Column, Table, print_lines
from pcretrieve.benchmarks.timing import use_one_core
from pcretrieve.checks import Check, findings_of, verdict_of
from pcretrieve.descriptors import describe
from pcretrieve.errors import BenchmarkError, PcretrieveError
from pcretrieve.evaluation.measures import evaluate_rankings
from pcretrieve.evaluation.rankings import rank_gallery
from pcretrieve.ingestion.views import read_views
from pcretrieve.options import MergeOptions, PipelineOptions
from pcretrieve.pipeline.seen import Seen
from pcretrieve.pipeline.spectra import shape_of
from pcretrieve.pipeline.stages import stages
from pcretrieve.points.register import merge_views
from pcretrieve.retrieval.ranking import DistanceBlock
from pcretrieve.simulation import POSES, SEATED, RigOptions, body, make_subject, on_support, scan
from pcretrieve.surface.sampling import uniform_points
from pcretrieve.values import FloatArray, PointCloud, Shape

__all__ = ["main"]

# The views of the bunny from a turntable.
TURNTABLE = ("bun000", "bun045", "bun090", "bun180", "bun270", "bun315")

# People whose limbs touch nothing: where limbs touch, two scans of one body differ more than by a base.
N_SUBJECTS = 5
PERSON_POSES = ("stand", "wave", "reach_up", "sit")
RIG = RigOptions(n_points=30_000)

# Number of random points of a surface, and the distance from the points of the other cloud that counts as
# near; relative to the diagonal.
N_PROBES = 100_000
NEAR = 0.01

TABLE = Table(
    Column("figure", 66, align="<"), Column("asked", 7, align="<"), Column("measured", 8, align="<")
)


class Scanned(NamedTuple):
    """One scan through all stages.

    Attributes
    ----------
    seen : Seen
        The results of the stages.
    shape : Shape
        The surfaces with their spectra.
    log_signature : (L,) float64
        By the default options.
    """

    seen: Seen
    shape: Shape
    log_signature: FloatArray


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table.

    Parameters
    ----------
    arguments : sequence of str, optional
        By default the arguments of the command line.
    """
    parser = argument_parser(__doc__)
    add_data(parser)
    parser.add_argument("--only", choices=PARTS, help="one part only")
    parser.add_argument("--limit", type=positive, metavar="N", help="N people only, evenly spread")
    given = parser.parse_args(arguments)
    use_one_core()
    try:
        with threadpool_limits(limits=1):
            print_lines(_lines(given.data, given.only, given.limit))
    except PcretrieveError as error:
        sys.exit(str(error))


def _lines(data: Path, only: str | None, limit: int | None) -> Iterator[str]:
    yield TABLE.head
    for name, part in PARTS.items():
        if only in (None, name):
            yield from part(data, limit)


def _bunny(data: Path, _: int | None) -> Iterator[str]:
    """The bunny from six views of a turntable and from all ten, and the checks of the ten."""
    folder = data / "stanford_bunny"
    if missing := left_out("bunny", folder):
        yield missing
        return
    views = read_views([folder])
    merged = merge_views(views.clouds, MergeOptions())
    turned = [k for k, file in enumerate(views.files) if file.stem in TURNTABLE]
    # The frame of both is that of the first view.
    fewer = merge_views([views.clouds[k] for k in turned], MergeOptions())
    six, ten = _processed(fewer.cloud), _processed(merged.cloud)
    area = abs(six.shape.mesh.area / ten.shape.mesh.area - 1)
    yield TABLE.row("bunny, six views against ten: difference of the area", "3 %", f"{area:.2%}")
    apart = "  surface within 1 % of the diagonal of the points, base aside"
    yield TABLE.row(apart, "99 %", f"{_near(six, ten.seen):.2%}")
    error = np.linalg.norm(six.log_signature - ten.log_signature)
    yield TABLE.row("  distance of the log-signatures", ".15", f"{error:.3f}")
    yield TABLE.row("  verdict on six views", "", str(verdict_of(_checks(six))))
    yield _failed("bunny, ten raw views: checks that failed", ten)


def _dragon(data: Path, _: int | None) -> Iterator[str]:
    """The checks of the dragon from its raw views."""
    folder = data / "stanford_dragon"
    if missing := left_out("dragon", folder):
        yield missing
        return
    views = read_views([folder / "dragonStandRight.conf"])
    merged = merge_views(views.clouds, MergeOptions(), poses=views.poses)
    yield _failed("dragon, fifteen raw views: checks that failed", _processed(merged.cloud))


def _people(_: Path, limit: int | None) -> Iterator[str]:
    """People whose soles and seats were not seen, against their whole scans; floods of the whole scans."""
    everybody = [(subject, pose) for subject in range(N_SUBJECTS) for pose in PERSON_POSES]
    labels, whole, based = [], [], []
    for number, (subject, pose) in progress(spread(everybody, limit), "people"):
        mesh = body(
            make_subject("person", np.random.default_rng(subject)),
            POSES["person"][pose],
            np.random.default_rng((subject, number)),
        )
        cloud = scan(mesh, RIG, np.random.default_rng((subject, number, 1)))
        unseen = on_support(mesh, cloud.points, seated=pose in SEATED)
        labels.append(f"person{subject}")
        whole.append(_processed(cloud))
        based.append(_processed(cloud.select(~unseen)))
    gallery = np.array([one.log_signature for one in whole])
    queries = np.array([one.log_signature for one in based])
    errors = np.linalg.norm(queries - gallery, axis=1)
    what = f"{len(labels)} people without soles and seats: log-signature error, median"
    yield TABLE.row(what, "", f"{np.median(errors):.3f}")
    if len(set(labels)) < len(labels):
        maps = [_mean_average_precision(from_, gallery, labels) for from_ in (queries, gallery)]
        yield TABLE.row("  mAP less than of whole scans", ".02", f"{maps[1] - maps[0]:.3f}")
        yield TABLE.row("  mAP, and of whole scans", "", f"{maps[0]:.3f} {maps[1]:.3f}")
    twice = np.mean([any("leaked" in note for note in _notes(one, "orient")) for one in whole])
    yield TABLE.row("whole scans that are flooded twice for the normals", "10 %", f"{twice:.0%}")


def _processed(cloud: PointCloud) -> Scanned:
    options = PipelineOptions()
    *_, seen = stages(cloud, options)
    shape = shape_of(seen, options)
    return Scanned(seen, shape, np.log(describe(shape, options.signature).values))


def _checks(scanned: Scanned) -> tuple[Check, ...]:
    seen = scanned.seen
    return findings_of(seen.cloud, seen.mesh, seen.marks, scanned.shape).checks


def _failed(what: str, scanned: Scanned) -> str:
    """The line of the checks of a scan that failed."""
    failed = [f"{check.name}: {check.shown}" for check in _checks(scanned) if check.verdict == "failed"]
    return TABLE.row(what, "none", "; ".join(failed) or "none")


def _notes(scanned: Scanned, stage: str) -> tuple[str, ...]:
    return tuple(note for step in scanned.shape.provenance if step.stage == stage for note in step.notes)


def _near(scanned: Scanned, other: Seen) -> float:
    """The fraction of a surface, without its base, that is near the points of another scan of the body."""
    if scanned.seen.cloud is None or scanned.seen.marks is None or other.cloud is None:
        raise BenchmarkError("the surface must be reconstructed from points, got a mesh")
    probes, _ = uniform_points(scanned.shape.mesh, N_PROBES, np.random.default_rng(0))
    base = scanned.seen.marks.base
    if len(base):
        to_points, to_base = (
            np.asarray(cKDTree(places).query(probes)[0]) for places in (scanned.seen.cloud.points, base)
        )
        probes = probes[to_points <= to_base]
    distance = np.asarray(cKDTree(other.cloud.points).query(probes)[0])
    return float((distance <= NEAR * other.cloud.diagonal).mean())


def _mean_average_precision(queries: FloatArray, gallery: FloatArray, labels: Sequence[str]) -> float:
    """That of each query in the gallery without the scan of the same body in the same pose."""
    distances = np.linalg.norm(queries[:, None] - gallery, axis=2)
    block = DistanceBlock(np.arange(len(labels)), distances)
    ids = [f"{k:03}" for k in range(len(labels))]
    return evaluate_rankings(rank_gallery([block], ids, labels)).map


PARTS: dict[str, Callable[[Path, int | None], Iterator[str]]] = {
    "bunny": _bunny,
    "people": _people,
    "dragon": _dragon,
}
