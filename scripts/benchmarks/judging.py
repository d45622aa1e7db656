"""What the pipeline finds of one scan: its signature, its checks, its grade and its surface."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from pcretrieve.checks import grade_of
from pcretrieve.descriptors import DESCRIPTORS, describe
from pcretrieve.errors import ShapeError
from pcretrieve.options import JUDGED, PipelineOptions
from pcretrieve.pipeline.process import checked, shape_of, stages
from pcretrieve.retrieval import Whitening, coordinates, fit_whitening, people
from pcretrieve.retrieval.people import People
from pcretrieve.values import FloatArray, PointCloud, TriangleMesh

# The words of a grade, and of a scan that has no surface.
FAILED = "failed"


@dataclass(frozen=True)
class Examined:
    """What is found of one scan.

    word: that of the grade, or "failed".
    point, judged: coordinates of the default signature, (177,), and of that by which scans are judged, (23,).
    checks: of each check by its name, the outcome, the measurement and the expected error.
    """

    word: str
    expected_error: float
    reasons: tuple[str, ...] = ()
    point: tuple[float, ...] = ()
    judged: tuple[float, ...] = ()
    checks: dict[str, dict[str, Any]] = field(default_factory=dict)
    area: float = float("nan")
    euler: int = 0
    n_points: int = 0
    seconds: float = 0.0

    @property
    def is_good(self) -> bool:
        return self.word == "good"

    def as_row(self) -> dict[str, Any]:
        """The result as plain values, for a file of JSON."""
        return asdict(self)


def examined(
    scan: PointCloud | TriangleMesh, options: PipelineOptions | None = None
) -> tuple[Examined, TriangleMesh | None]:
    """Examine a scan; its first surface, if there is one."""
    options = options or PipelineOptions()
    n_points = len(scan.points) if isinstance(scan, PointCloud) else len(scan.vertices)
    started, surface = time.process_time(), None
    try:
        with threadpool_limits(limits=1):
            for last in stages(scan, options):
                surface = last.mesh
            shape = shape_of(last, options)
            own = point_of(describe(shape, options.signature).values, options)
            checks = checked(last, shape).checks
            grade = grade_of(checks)
            seconds = time.process_time() - started
            judging = options.changed(signature=JUDGED)
            judged = point_of(describe(shape, judging.signature).values, judging)
    except ShapeError as failure:
        seconds = time.process_time() - started
        words = (f"{failure.stage}: {failure.message}",)
        return Examined(
            FAILED, float("nan"), words, n_points=n_points, seconds=seconds
        ), surface
    listed = {
        check.name: {"outcome": check.outcome, "value": check.value, "error": check.error}
        for check in checks
    }
    return Examined(
        grade.name,
        grade.error,
        grade.reasons,
        tuple(own.tolist()),
        tuple(judged.tolist()),
        listed,
        shape.mesh.area,
        shape.mesh.euler_characteristic,
        n_points,
        seconds,
    ), surface


def point_of(values: FloatArray, options: PipelineOptions) -> FloatArray:
    """(L,) the coordinates of the values of a signature."""
    metric = DESCRIPTORS[options.signature.method].metric
    return np.asarray(coordinates(values[np.newaxis], metric)[0])


def moments_of_people(
    sample: Mapping[str, FloatArray] | None = None, size_weight: float = 0.0
) -> People:
    """The moments of people for the default signature; `sample` as in `people`."""
    options = PipelineOptions().changed(signature={"size_weight": size_weight})
    known = people(options.signature, sample)
    if known is None:
        raise TypeError("the metric of people must be known for the default signature")
    return known


def metric_of_people(
    sample: Mapping[str, FloatArray] | None = None, size_weight: float = 0.0
) -> Whitening:
    """The whitening of people for the default signature, as it is for a gallery that teaches nothing."""
    known = moments_of_people(sample, size_weight)
    return fit_whitening("people", known.mean[np.newaxis], people=known)
