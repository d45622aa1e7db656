"""One scan → its `Inspection`: checks of the result of each stage, and rescans of its signature."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pcretrieve.checks import OUTCOMES, Check, Inspection, graded
from pcretrieve.errors import OptionError, ShapeError
from pcretrieve.formats import ScanLike, ScanPath, is_scan, located
from pcretrieve.formats.identity import printable
from pcretrieve.options import JUDGED, OptionsLike, PipelineOptions
from pcretrieve.pipeline.process import (
    Seen,
    checked,
    placed,
    shape_of,
    signature,
    signature_of,
    stages,
)
from pcretrieve.points import outliers
from pcretrieve.values import Failure, FloatArray, PointCloud
from pcretrieve.values.files import check_target

# Number of points in each rescan, relative to all points.
RESCAN_SHARE = 0.9

# Distance to the nearest point that the stage clean left, beyond which it removed a point, in median
# distances between nearest neighbours: voxels move the points that they keep.
DROPPED = 1.1


def check_targets(scan: ScanLike, *targets: str | Path | None) -> None:
    """Check that files can be written before a scan is inspected, and that none of them is read for it."""
    place = located(scan)
    sources = [place.file] if isinstance(place, ScanPath) else []
    for target in targets:
        if target is not None:
            check_target(Path(target), sources)


def inspect_scan(
    scan: ScanLike, options: OptionsLike = None, *, n_rescans: int = 4
) -> Inspection:
    """Process a scan, and check the result of each stage.

    If a stage fails, the results of the earlier stages are checked. Rescans are simulated by reconstructing
    the surface from random parts of the points.

    Returns Inspection: lengths are in the unit of the scan.
    """
    options = PipelineOptions.of(options).changed(signature=JUDGED)
    if n_rescans == 1 or n_rescans < 0:
        raise OptionError(
            f"the error of rescans needs at least 2 rescans, got {n_rescans}"
        )
    scan = located(scan)
    path = printable(scan) if isinstance(scan, ScanPath) else ""
    name = Path(path).name or "scan"
    seen, shape, described, failure = Seen(), None, None, None
    rescan_errors, rescan_error = None, None
    try:
        with placed(scan):
            for reached in stages(scan, options):
                seen = reached  # which stays if the next stage fails
            shape = shape_of(seen, options)
            described = signature_of(shape, options)
            if n_rescans and seen.scan is not None:
                rescan_errors = _rescan_errors(seen.scan, options, n_rescans)
                rescan_error = float(np.sqrt((rescan_errors**2).sum()))
    except ShapeError as error:
        if isinstance(scan, ScanPath) and seen.scan is None and not is_scan(scan):
            raise  # a file of another kind, of which there is nothing to show
        failure = Failure(
            name, error.stage or "worker", type(error).__name__, error.message
        )
    found = checked(seen, shape)
    checks = [*found.checks]
    if rescan_error is not None:
        checks.append(
            graded("Signature", rescan_error, f"± {rescan_error:.2g} over rescans")
        )
    if failure is not None and described is None:
        checks.append(
            Check(
                f"The {failure.stage} stage",
                "failed",
                None,
                failure.error,
                failure.message,
            )
        )
    elif failure is not None:
        shown = "none for nine tenths of the points"
        checks.append(Check("Signature", "failed", None, shown, failure.message))
    cut_away, dropped = _removed(seen, options)
    return Inspection(
        name=name,
        path=path,
        checks=tuple(sorted(checks, key=lambda check: OUTCOMES.index(check.outcome))),
        scan=seen.scan,
        cut_away=cut_away,
        dropped=dropped,
        cloud=seen.cloud,
        spacing=_median_spacing(seen.scan.points)
        if seen.scan and not seen.cloud
        else found.spacing,
        mesh=seen.mesh,
        filled=found.filled,
        cuts=found.cuts,
        bridges=found.bridges,
        signature=described,
        rescan_errors=rescan_errors,
        rescan_error=rescan_error,
        failure=failure if described is None else None,
        steps=next(
            (
                part.provenance
                for part in (seen.mesh, seen.cloud, seen.scan)
                if part is not None
            ),
            (),
        ),
    )


def _rescan_errors(cloud: PointCloud, options: PipelineOptions, n: int) -> FloatArray:
    """(L,) the standard deviation (ddof 0) of the log-signature over random parts of the points.

    It includes the random errors of sampling, and of the cuts, bridges and filled holes that depend on it. It
    does not include systematic errors, as of a side that was not scanned.
    """
    rng = np.random.default_rng(0)
    size = round(RESCAN_SHARE * len(cloud.points))
    parts = [
        np.sort(rng.choice(len(cloud.points), size, replace=False)) for _ in range(n)
    ]
    logs = np.log(
        [signature(cloud.select(part), options).values for part in parts]
    )  # (n, L)
    return np.asarray(logs.std(axis=0))


def _removed(
    seen: Seen, options: PipelineOptions
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """The points of a scan that the stage crop removed, and those that the stage clean removed, (n,) each."""
    n = 0 if seen.scan is None else len(seen.scan.points)
    cut_away, dropped = np.zeros(n, dtype=np.bool_), np.zeros(n, dtype=np.bool_)
    if seen.scan is None or seen.cropped is None:
        return cut_away, dropped
    points = seen.scan.points
    cut_away = _distance(seen.cropped, points) > 0  # crop does not move points
    if seen.cleaned is not None and len(seen.cropped.points) == n - cut_away.sum():
        dropped[~cut_away] = outliers(seen.cropped, options.scan)
    elif seen.cleaned is not None:
        reach = DROPPED * _median_spacing(seen.cleaned.points)
        dropped = ~cut_away & (_distance(seen.cleaned, points) > reach)
    return cut_away, dropped


def _median_spacing(points: FloatArray) -> float:
    """The median distance of points to their nearest neighbours; 0 if there are fewer than two."""
    return (
        float(np.median(cKDTree(points).query(points, k=[2])[0]))
        if len(points) > 1
        else 0.0
    )


def _distance(cloud: PointCloud, places: FloatArray) -> FloatArray:
    """The distance of each place to the nearest point of a cloud, (n,)."""
    return np.asarray(cKDTree(cloud.points).query(places)[0])
