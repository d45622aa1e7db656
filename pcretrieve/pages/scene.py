"""Points and faces → the layers of the 3-D viewer, as base64 of little-endian arrays; measures of bodies."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pcretrieve import TriangleMesh, eigenpairs, laplace_beltrami
from pcretrieve.draw.axes import body_axes, person_of
from pcretrieve.draw.pictures import CLAY, Colour
from pcretrieve.pages.html import encoded
from pcretrieve.values import FloatArray, RayScene, unit_vectors

#: Half of the side of the cube that the viewer can show, with room for outliers near the body; farther
#: outliers are left out. Relative to the radius of the bounding ball of the body.
VIEWER_SIZE = 1.25

# Colours where a body is as thick as another one, thicker and thinner. Differences relative to the root of
# the area: that of three quarters of the skin of one person in two scans, which has no colour, and that of
# the full colour, 6 cm of a person. The number of eigenpairs, and of places that are alike.
ALIKE = np.array([0.93, 0.93, 0.91])
THICKER = np.array([0.75, 0.15, 0.10])
THINNER = np.array([0.12, 0.30, 0.75])
USUAL = 0.0085
FULL_COLOUR = 0.045
N_PAIRS = 61
N_ALIKE = 20

# Largest 16-bit integer, in which the viewer stores coordinates.
FULL_SCALE = 2**16 - 1


class Cube(NamedTuple):
    """The cube that a viewer can show: its centre (3,) and half of its side, in the unit of the scan."""

    centre: FloatArray
    half: float

    @classmethod
    def around(cls, body: FloatArray) -> Cube:
        """The cube around the (n, 3) points of a body."""
        centre = (body.min(axis=0) + body.max(axis=0)) / 2
        # Equal points have the reach 1.
        reach = float(np.linalg.norm(body - centre, axis=1).max()) or 1.0
        return cls(centre, VIEWER_SIZE * reach)

    def holds(self, points: FloatArray) -> NDArray[np.bool_]:
        """Which of (n, 3) points are in the cube."""
        return np.asarray((abs(points - self.centre) <= self.half).all(axis=1))

    def layer(
        self,
        name: str,
        label: str,
        points: FloatArray,
        colour: Colour,
        *,
        width: float,
        **more: Any,
    ) -> dict[str, Any]:
        """A layer of those of (n, 3) points that are in the cube, with a width in the unit of the scan."""
        grid = (
            (points[self.holds(points)] - self.centre + self.half)
            / (2 * self.half)
            * FULL_SCALE
        )
        at = encoded(np.round(grid).astype("<u2").tobytes())
        facts = {"name": name, "label": label, "colour": colour}
        return facts | {"width": width / self.half, "at": at} | more


def surface_scene(
    mesh: TriangleMesh, up: FloatArray | None, other: TriangleMesh | None = None
) -> dict[str, Any]:
    """A surface as the only layer, seen from its front; without `up`, this is found from the surface.

    other: a surface to compare with, in the same unit: faces are red where this one is thicker, blue where it
        is thinner, and white where the difference is usual for one person.
    """
    cube, faces = Cube.around(mesh.vertices), encoded(mesh.faces.astype("<u4").tobytes())
    layer = cube.layer("surface", "surface", mesh.vertices, CLAY, width=0, faces=faces)
    if other is not None:
        differs = (thicker(mesh, other) / mesh.area**0.5)[:, None]  # (m, 1)
        share = np.clip((abs(differs) - USUAL) / (FULL_COLOUR - USUAL), 0, 1)
        tints = ALIKE + share * (np.where(differs > 0, THICKER, THINNER) - ALIKE)
        layer["tints"] = encoded(np.round(255 * tints).astype(np.uint8).tobytes())
    axes = body_axes(mesh.vertices, mesh.faces, up).tolist()
    return {"layers": [layer], "on": ["surface"], "axes": axes, "zoom": VIEWER_SIZE}


def thicker(mesh: TriangleMesh, other: TriangleMesh) -> FloatArray:
    """(m,) by how much a body is thicker at each face than another body at such places, in the unit of both.

    Places are alike by their heat kernels, whatever the poses; the thickness is the way through the body.
    """
    own, its = _places(mesh), _places(other)
    # (m, N_ALIKE) each.
    alike = [ways[cKDTree(heat).query(own[0], N_ALIKE)[1]] for heat, ways in (own, its)]
    return np.median(alike[0], axis=1) - np.median(alike[1], axis=1)


def _places(mesh: TriangleMesh) -> tuple[FloatArray, FloatArray]:
    """Logarithms of the heat kernel (m, 8) at each face, and the thickness there (m,)."""
    pairs = eigenpairs(laplace_beltrami(mesh), n_pairs=N_PAIRS)
    lam, phi = pairs.eigenvalues[1:], pairs.eigenvectors[:, 1:]
    heat = np.log(
        mesh.area
        * (phi**2 @ np.exp(-np.outer(lam, np.geomspace(8 / lam[-1], 4 / lam[0], 8))))
    )
    corners = mesh.vertices[mesh.faces]  # (m, 3, 3)
    normals = unit_vectors(mesh.area_vectors)
    below = corners.mean(axis=1) - 1e-4 * mesh.diagonal * normals
    ways, _, _ = RayScene(mesh.vertices, mesh.faces).cast(below, -normals)
    return heat[mesh.faces].mean(axis=1), np.where(np.isfinite(ways), ways, 0)


def measures(mesh: TriangleMesh, up: FloatArray | None) -> dict[str, float]:
    """Height, area and volume of a body; of a person lengths and girths over the skin, in any pose.

    A girth is a line of points that are equally far from feet or hands: the waist half-way from the pelvis to
    the chest, a thigh and an upper arm at three quarters of the limb.
    """
    along = mesh.vertices @ body_axes(mesh.vertices, mesh.faces, up)[1]
    found = {"height": float(np.ptp(along)), "area": mesh.area, "volume": mesh.volume}
    if (person := person_of(mesh.vertices, mesh.faces)) is not None:
        feet, hands = person.from_feet.mean(axis=0), person.from_hands
        pelvis, chest = (
            person.from_feet.max(axis=0).min(),
            feet[hands.max(axis=0).argmin()],
        )
        found["head to foot"] = float(
            feet[abs(hands[0] - hands[1]) < 0.2 * hands.max()].max()
        )
        found["waist"] = _girth(mesh, feet, (pelvis + chest) / 2)
        limbs = {
            "thigh": (person.from_feet, person.feet),
            "upper arm": (hands, person.hands),
        }
        for name, (ways, ends) in limbs.items():
            found[name] = (
                sum(_girth(mesh, way, 0.375 * ways[0, ends[1]]) for way in ways) / 2
            )
    return found


def _girth(mesh: TriangleMesh, values: FloatArray, level: float) -> float:
    """The length of the line on a surface along which values, linear on each face, have a level."""
    first, second = mesh.faces, np.roll(mesh.faces, 1, axis=1)  # (m, 3) the ends of sides
    above, then = values[first] - level, values[second] - level
    share = above / np.where(above == then, 1, above - then)
    places = mesh.vertices[first] + share[..., None] * (
        mesh.vertices[second] - mesh.vertices[first]
    )
    # Of a face, no sides or two are crossed, one upwards and one downwards.
    crossed = (above > 0).astype(float) - (then > 0)
    return float(np.linalg.norm((crossed[..., None] * places).sum(axis=1), axis=1).sum())
