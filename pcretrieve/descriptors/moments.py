"""Moments of a surface along its principal axes, which find copies of one body in one pose.

They are integrals, which change little with triangulation, noise and small holes, and not at all in a mirror;
but they change with the pose. See docs/decisions.md, `SAME`.
"""

from __future__ import annotations

import numpy as np

from pcretrieve.descriptors.descriptor import Descriptor
from pcretrieve.errors import DegenerateMeshError
from pcretrieve.values import Signature, TriangleMesh


def moments(mesh: TriangleMesh) -> Signature:
    """The standard deviation σ along each principal axis, and the root of m₄ / σ², with m₄ the fourth moment.

    values : (6,) in units of √A, smallest σ first. On an axis of a sphere, both are in the ratio 1 : √(9/5).
    """
    framed = in_principal_frame(mesh)
    corners = framed.vertices[framed.faces]  # (m, 3, 3)
    middles = (corners + np.roll(corners, 1, axis=1)) / 2  # of the edges
    second, fourth = (framed.face_areas @ (middles**power).mean(axis=1) for power in (2, 4))  # (3,)
    second = np.maximum(second, np.finfo(float).eps)  # of a surface in a plane
    return Signature(np.sqrt(np.concatenate([second, fourth / second])), kind="moments")


def in_principal_frame(mesh: TriangleMesh) -> TriangleMesh:
    """The surface of unit area, oriented outwards, with its centre and principal axes as the frame."""
    areas = mesh.face_areas
    if not 0 < (total := float(areas.sum())) < np.inf:
        raise DegenerateMeshError(f"a surface must have a positive area, got an area of {total:g}")
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))  # (m, 3) each
    centre = areas @ (a + b + c) / (3 * total)
    # The midpoints of the edges integrate quadratics over a triangle exactly.
    middles = np.concatenate([a + b, b + c, c + a]) / 2 - centre
    axes = np.linalg.eigh(middles.T @ (np.tile(areas, 3)[:, np.newaxis] * middles))[1]
    turned = TriangleMesh((mesh.vertices - centre) @ axes / np.sqrt(total), mesh.faces)
    return turned if turned.volume >= 0 else TriangleMesh(turned.vertices, turned.faces[:, ::-1])


MOMENTS = Descriptor(
    name="moments",
    make=lambda shape, _: moments(shape.mesh),
    needs=("mesh",),
    has_size=False,
    length=lambda _: 6,
    spread=0.55,
)
