"""Points, surface and spectrum of a scan → checks, and the places that they name."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pcretrieve.arrays import joined_by
from pcretrieve.checks import stages
from pcretrieve.checks.fit import Fit, between
from pcretrieve.checks.grading import ENDS_OF_WHOLE, LIMBLESS, Check
from pcretrieve.checks.layers import double_layers
from pcretrieve.draw.axes import Person, person_of
from pcretrieve.points.neighbors import Neighborhoods, nearest, neighborhoods
from pcretrieve.retrieval import limbless_ratio
from pcretrieve.values import FloatArray, PointCloud, Shape, Signature, TriangleMesh
from pcretrieve.values.topology import SurfaceMarks

# Number of neighbours with whose normals the normal of a point is compared.
N_NEIGHBORS = 8

# Largest distance of voxels that belong to one cut or bridge, relative to the diagonal.
PLACE = 0.02

# Parts of a person by the ways over the surface to the nearest foot and hand, relative to the way from a hand
# to a foot. What lies between two parts has no name, so that a name is right: for 97 % or more of the
# vertices that have it, on 113 people of Anny; of an arm for 92 %, with a zone that ended at .27.
FOOT = 0.08
LEG = 0.42
HAND = 0.07
ARM = 0.24
BESIDE_ARMS = 0.34
PELVIS = 0.48
SHOULDERS = 0.73
CHIN = 0.79


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """The checks of one scan, and the places that they name.

    spacing: median distance from a point to its nearest neighbour, unit of the file; 0 without points.
    filled: (m,) bool, faces of the surface without a point nearby.
    cuts, bridges: (k, 3) float64, places where parts of the surface that touch were separated, and where a
        loose part was connected.
    """

    checks: tuple[Check, ...] = ()
    spacing: float = 0.0
    filled: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    cuts: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    bridges: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))


def findings_of(
    cloud: PointCloud | None,
    mesh: TriangleMesh | None,
    marks: SurfaceMarks | None,
    shape: Shape | None,
    *,
    judged: Signature | None = None,
    scan: PointCloud | None = None,
    around: Neighborhoods | None = None,
) -> Findings:
    """Check the results of the stages of a scan, up to some stage.

    judged: the signature by `JUDGED`, if there is one.
    scan: the points before they were thinned; without them, densities are those of the thinned points.
    around: neighbours of some points of the cloud, if they are known.
    Returns Findings: lengths are in the unit of the file.
    """
    checks: list[Check] = []
    ratio = None if judged is None else limbless_ratio(judged.values)
    spacing = 0.0
    filled = np.zeros(0 if mesh is None else len(mesh.faces), dtype=np.bool_)
    cuts = bridges = np.zeros((0, 3))
    if cloud is not None:
        if around is None:
            around = neighborhoods(cloud.points, N_NEIGHBORS + 1, of_some=True)
        spacing = between(around)
        checks += stages.point_checks(cloud, spacing=spacing)
        if cloud.normals is not None:
            checks += stages.normal_checks(
                cloud.normals, around.near[:, : N_NEIGHBORS + 1]
            )
            checks.append(stages.layers_check(double_layers(cloud), cloud.diagonal))
        if mesh is not None:
            base = np.zeros((0, 3)) if marks is None else marks.base
            fit = Fit(cloud, around, mesh, cloud if scan is None else scan, base)
            filled = fit.filled
            is_whole = ratio is not None and ratio < -LIMBLESS
            checks += stages.fit_checks(fit, ENDS_OF_WHOLE if is_whole else 0.0)
            if len(base):
                area = fit.share(fit.on_base)
                checks.append(stages.base_check(area, on_ground=cloud.up is not None))
        if marks is not None:
            reach = PLACE * cloud.diagonal
            cuts, bridges = _places(marks.cuts, reach), _places(marks.bridges, reach)
            checks.append(stages.marks_check(len(cuts), len(bridges)))
    if mesh is not None:
        checks += [*stages.surface_checks(mesh), *stages.mesh_check(mesh.provenance)]
    if shape is not None:
        checks += stages.spectrum_checks(shape)
    if mesh is not None and ratio is not None:
        checks.append(stages.limbs_check(ratio))
    if mesh is not None:
        checks = _with_parts(checks, mesh)
    return Findings(tuple(checks), spacing, filled, cuts, bridges)


def _with_parts(checks: list[Check], mesh: TriangleMesh) -> list[Check]:
    """The checks, with the names of the parts of a person on which their places are."""
    if not any(check.places for check in checks):
        return checks
    person = person_of(mesh.vertices, mesh.faces)
    if person is None:
        return checks
    return [
        replace(check, parts=parts_at(np.array(check.places), mesh, person))
        if check.places
        else check
        for check in checks
    ]


def parts_at(places: FloatArray, mesh: TriangleMesh, person: Person) -> tuple[str, ...]:
    """The parts of a person on which places (k, 3) are, each once; none if one of the places has no name."""
    at = nearest(mesh.vertices, places, 1)[1][:, 0]
    whole = person.from_feet[:, person.hands].mean()
    to_foot = person.from_feet.min(axis=0)[at] / whole
    to_hand = person.from_hands.min(axis=0)[at] / whole
    names = tuple(dict.fromkeys(map(part_of_person, to_foot, to_hand)))
    return () if "" in names else names


def part_of_person(to_foot: float, to_hand: float) -> str:
    """The part by the ways to the nearest foot and hand; empty where it is uncertain."""
    if to_foot < LEG:
        return "a foot" if to_foot < FOOT else "a leg"
    if to_hand < ARM:
        return "a hand" if to_hand < HAND else "an arm"
    if to_hand > BESIDE_ARMS and to_foot > CHIN:
        return "the head"
    if to_hand > BESIDE_ARMS and PELVIS < to_foot < SHOULDERS:
        return "the trunk"
    return ""


def _places(cells: FloatArray, reach: float) -> FloatArray:
    """Centroids of groups of cells, (p, 3); cells nearer to each other than `reach` are in one group."""
    if not len(cells):
        return cells
    from scipy.spatial import cKDTree

    a, b = cKDTree(cells).query_pairs(reach, output_type="ndarray").T
    group = joined_by(a, b, len(cells))
    sums = np.stack([np.bincount(group, cells[:, axis]) for axis in range(3)], axis=1)
    return sums / np.bincount(group)[:, None]
