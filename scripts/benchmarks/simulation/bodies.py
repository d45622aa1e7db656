"""Articulated bodies: people in many poses; benchmarks add other families.

A body is the skin of a subject, a smooth surface round the flesh, which follows the bones by linear blend
skinning.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from types import ModuleType

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.sparse import csc_array, diags_array
from scipy.sparse.linalg import splu

from benchmarks.simulation import people
from benchmarks.simulation.skeleton import (
    Bone,
    Contact,
    Pose,
    Subject,
    bone_distance,
    cone_distance,
    motions,
)
from pcretrieve.errors import InputError, OptionError
from pcretrieve.spectral import laplace_beltrami
from pcretrieve.surface.marching import level_set
from pcretrieve.values import FloatArray, TriangleMesh

# Measures are clipped to this many standard deviations about the mean.
LARGEST_DEVIATION = 2.0

# Modules with the distributions of measures, the function that builds a skeleton, the cell, and poses.
FAMILIES: dict[str, ModuleType] = {"person": people}

POSES: Mapping[str, dict[str, Pose]] = {
    name: family.POSES for name, family in FAMILIES.items()
}
"""Poses by family and name. In poses with contacts (`Pose.contacts`) parts of the body touch each other."""


def make_subject(family: str, rng: np.random.Generator) -> Subject:
    """An individual of a family, with lengths and girths drawn from normal distributions."""
    if family not in FAMILIES:
        raise OptionError(f"family must be one of {', '.join(FAMILIES)}, got {family!r}")
    kind = FAMILIES[family]
    deviations = np.clip(
        rng.standard_normal(len(kind.MEASURES)), -LARGEST_DEVIATION, LARGEST_DEVIATION
    )
    measures = {
        name: mean * (1 + spread * deviation)
        for (name, (mean, spread)), deviation in zip(
            kind.MEASURES.items(), deviations.tolist(), strict=True
        )
    }
    return Subject(family, kind.skeleton(measures), kind.CELL)


def body(
    subject: Subject,
    pose: Pose,
    rng: np.random.Generator | None = None,
    *,
    jitter: float = 2.0,
) -> TriangleMesh:
    """The surface of a subject in a pose.

    All poses of one subject have the same faces, so that each surface is a closed manifold of Euler
    characteristic 2, even where parts touch; there the surface may intersect itself slightly. It has about
    7000 vertices; m. The first call for a subject computes the skin, which takes some seconds.

    jitter: standard deviation of random changes of the angles, if there is an `rng`; degrees.
    """
    strange = sorted(pose.joints - subject.joints)
    if strange:
        raise InputError(
            f"a pose must turn joints of the {subject.family}, got {', '.join(strange)}: "
            f"take one of POSES[{subject.family!r}]"
        )
    if rng is not None:
        pose = pose.jittered(subject.joints, jitter, rng)
    own = skin(subject)
    moved = motions(subject, close_contacts(own, pose))
    return TriangleMesh(blend(own.weights, moved, own.rest.vertices), own.rest.faces)


# Rounds of tangential smoothing after marching cubes, which suffice to remove thin triangles.
SMOOTHING_STEPS = 5

# Step of the finite differences of the implicit function; cells.
GRADIENT_STEP = 0.01

# The constant c of Baran and Popović: with a larger value vertices follow the nearest bone more closely.
ATTACHMENT = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Skin:
    """A surface in the rest pose, and how it follows the bones.

    weights: (n, b) float64, skinning weight of each bone for each vertex; rows sum to 1.
    owner: (n,) intp, number of the bone whose flesh is nearest to each vertex at rest.
    """

    subject: Subject
    rest: TriangleMesh
    weights: FloatArray
    owner: NDArray[np.intp]


@lru_cache(maxsize=16)
def skin(subject: Subject) -> Skin:
    """The skin of a subject."""
    rest = _rest_surface(subject)
    owner = np.argmin(
        [bone_distance(bone, rest.vertices) for bone in subject.bones], axis=0
    )  # (n,)
    return Skin(subject, rest, _weights(subject, rest, owner), owner)


def blend(weights: FloatArray, moved: FloatArray, points: FloatArray) -> FloatArray:
    """Linear blend skinning: (n, 3) points after the means of the motions (b, 4, 4) by weights (n, b)."""
    mean = np.tensordot(weights, moved, axes=1)  # (n, 4, 4)
    return np.asarray(np.einsum("nij,nj->ni", mean[:, :3, :3], points) + mean[:, :3, 3])


def _rest_surface(subject: Subject) -> TriangleMesh:
    """Zero level set of the union of all flesh, by marching cubes and tangential smoothing."""
    cones = [cone for bone in subject.bones for cone in bone.flesh]
    ends = np.array([end for cone in cones for end in (cone.start, cone.end)])
    # The grid contains the fillets, which extend by at most a quarter of their width.
    reach = 1.5 * max(
        radius * max(cone.depth, 1) for cone in cones for radius in cone.radii
    )
    axes = [
        np.arange(low - reach, high + reach + subject.cell, subject.cell)
        for low, high in zip(ends.min(axis=0), ends.max(axis=0), strict=True)
    ]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)  # (x, y, z, 3)
    vertices, faces = level_set(-_flesh(subject, grid), 0.0)
    mesh = _smoothed(
        subject, TriangleMesh(vertices * subject.cell + grid[0, 0, 0], faces)
    )
    if mesh.euler_characteristic != 2:
        raise InputError(
            f"the flesh at rest must form one ball, of Euler characteristic 2, got "
            f"{mesh.euler_characteristic}: separate the limbs further, or connect loose ones"
        )
    return mesh


def _smoothed(subject: Subject, mesh: TriangleMesh) -> TriangleMesh:
    """Tangential smoothing: vertices move half way to the mean of their neighbours, then to the surface."""
    n = len(mesh.vertices)
    links = csc_array(
        (
            np.ones(mesh.faces.size),
            (mesh.faces.ravel(), np.roll(mesh.faces, 1, axis=1).ravel()),
        ),
        (n, n),
    )
    links = links + links.T
    mean = diags_array(1 / links.sum(axis=1)) @ links
    points = mesh.vertices
    for _ in range(SMOOTHING_STEPS):
        points = _on_surface(subject, (points + mean @ points) / 2)
    return TriangleMesh(points, mesh.faces)


def _on_surface(subject: Subject, points: FloatArray) -> FloatArray:
    """(n, 3) points after one Newton step, p − f ∇f / |∇f|², towards the zero level set."""
    step = GRADIENT_STEP * subject.cell
    shifted = (
        points + step * np.concatenate([np.zeros((1, 3)), np.eye(3)])[:, None]
    )  # (4, n, 3)
    here, *ahead = _flesh(subject, shifted)
    gradient = (np.stack(ahead, axis=-1) - here[:, None]) / step  # (n, 3)
    return np.asarray(points - (here / (gradient**2).sum(axis=1))[:, None] * gradient)


def _flesh(subject: Subject, points: FloatArray) -> FloatArray:
    """(…,) implicit function of all flesh at (…, 3) points: zero on the skin, negative inside; m."""
    field = np.full(points.shape[:-1], np.inf)
    for bone in subject.bones:
        for cone in bone.flesh:
            width = cone.fillet * min(cone.radii) * min(cone.depth, 1)
            field = _smooth_union(
                field, cone_distance(cone, bone.front, points), width=width
            )
    return field


def _smooth_union(a: FloatArray, b: FloatArray, *, width: float) -> FloatArray:
    """Smooth minimum: min(a, b) with a quadratic fillet where |a − b| < width.

    The quadratic polynomial of I. Quilez, "Smooth minimum", https://iquilezles.org/articles/smin.
    """
    overlap = np.maximum(1 - np.abs(a - b) / width, 0)
    return np.asarray(np.minimum(a, b) - overlap**2 * width / 4)


def _weights(subject: Subject, rest: TriangleMesh, owner: NDArray[np.intp]) -> FloatArray:
    """Skinning weights by heat equilibrium [1]_: (S + M H) W = M H P.

    S and M are stiffness and lumped mass of the surface, P is 1 for the bone nearest to each vertex and 0
    for others, and H = c / d² for its distance d, so that the weights change over about half of the
    thickness of a limb. Because S·1 = 0, the rows sum to 1.

    owner: (n,) intp, number of the bone whose flesh is nearest to each vertex.
    Returns (n, b) float64: between 0 and 1.

    References
    ----------
    .. [1] I. Baran and J. Popović, "Automatic rigging and animation of 3D characters", SIGGRAPH 2007,
       section 4: −Δw + H w = H p.
    """
    operator = laplace_beltrami(rest, mass="lumped")
    bones, points = subject.bones, rest.vertices
    # Links have no flesh of their own: they share the flesh of the bones that they join.
    shares = np.array(
        [[a is b or _links(a, b) or _links(b, a) for b in bones] for a in bones]
    )  # (b, b)
    to_bone = np.array([_segment_distance(bone, points) for bone in bones])  # (b, n)
    to_bone = np.where(shares[owner].T, to_bone, np.inf)
    marks = np.eye(len(bones))[to_bone.argmin(axis=0)]  # (n, b)
    heat = operator.mass @ diags_array(ATTACHMENT / to_bone.min(axis=0) ** 2)
    weights: FloatArray = splu(csc_array(operator.stiffness + heat)).solve(heat @ marks)
    # At obtuse triangles the discrete maximum principle fails: weights leave [0, 1] by a few hundredths.
    weights = np.maximum(weights, 0)
    weights /= weights.sum(axis=1, keepdims=True)
    return weights


def _links(link: Bone, bone: Bone) -> bool:
    return not link.flesh and (link.parent == bone.name or bone.parent == link.name)


def _segment_distance(bone: Bone, points: FloatArray) -> FloatArray:
    """(n,) distance from the segment between the ends of a bone; m."""
    axis = np.subtract(bone.tail, bone.head)
    offset = points - np.array(bone.head)
    along = np.clip(offset @ axis / (axis @ axis), 0, 1)
    return np.asarray(np.linalg.norm(offset - along[:, None] * axis, axis=1))


# Weight of the change of an angle (radians) against a gap (body sizes) in the least-squares problem: large
# enough to keep the joints near the given pose, small enough to close every gap to less than a thousandth of
# the body size.
STIFFNESS = 0.02

# Step of the finite differences, relative to each angle. The gap is not smooth in the angles, because the
# nearest vertex of the skin changes; the step is wide enough to average over these changes.
DIFFERENCE = 0.01


def close_contacts(skin: Skin, pose: Pose) -> Pose:
    """Change the angles of the joints of the contacts until these touch, by least squares.

    Residuals are the gaps, in body sizes, and `STIFFNESS` times the changes of the angles, in radians.
    """
    joints = sorted({joint for contact in pose.contacts for joint in contact.by})
    if not joints:
        return pose
    size = skin.subject.size
    given = np.radians(
        [pose.angles.get(joint, (0, 0, 0)) for joint in joints]
    ).ravel()  # (3j,)

    def turned(angles: FloatArray) -> Pose:
        triples = np.degrees(angles).reshape(-1, 3).tolist()
        changed = {
            joint: tuple(triple) for joint, triple in zip(joints, triples, strict=True)
        }
        return replace(pose, angles={**pose.angles, **changed})

    def residuals(angles: FloatArray) -> FloatArray:
        moved = motions(skin.subject, turned(angles))
        gaps = [_gap(skin, moved, contact) / size for contact in pose.contacts]
        return np.concatenate([gaps, STIFFNESS * (angles - given)])

    return turned(
        least_squares(residuals, given, diff_step=np.full(len(given), DIFFERENCE)).x
    )


def _gap(skin: Skin, moved: FloatArray, contact: Contact) -> float:
    """Signed distance from the skin of the moving part to the flesh of the other, negative inside; m."""
    bones = skin.subject.bones
    coming = np.isin(skin.owner, [skin.subject.number(name) for name in contact.bones])
    points = blend(skin.weights[coming], moved, skin.rest.vertices[coming])
    gaps = []
    for number in map(skin.subject.number, contact.onto):
        to_rest = np.linalg.inv(moved[number])
        gaps.append(
            bone_distance(
                bones[number], points @ to_rest[:3, :3].T + to_rest[:3, 3]
            ).min()
        )
    return float(min(gaps))
