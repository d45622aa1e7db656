"""Points and faces → the layers that the 3-D viewer in a browser draws, as base64 of little-endian arrays."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcretrieve import TriangleMesh
from pcretrieve.draw.axes import body_axes
from pcretrieve.draw.pictures import CLAY, Colour
from pcretrieve.pages.html import encoded
from pcretrieve.values import FloatArray

#: Half of the side of the cube that the viewer can show, with room for outliers near the body; farther
#: outliers are left out. Relative to the radius of the bounding ball of the body.
VIEWER_SIZE = 1.25

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
        reach = float(np.linalg.norm(body - centre, axis=1).max()) or 1.0  # if all points are equal
        return cls(centre, VIEWER_SIZE * reach)

    def holds(self, points: FloatArray) -> NDArray[np.bool_]:
        """Which of (n, 3) points are in the cube."""
        return np.asarray((abs(points - self.centre) <= self.half).all(axis=1))

    def layer(
        self, name: str, label: str, points: FloatArray, colour: Colour, *, width: float, **more: Any
    ) -> dict[str, Any]:
        """A layer of those of (n, 3) points that are in the cube, with a width in the unit of the scan."""
        grid = (points[self.holds(points)] - self.centre + self.half) / (2 * self.half) * FULL_SCALE
        at = encoded(np.round(grid).astype("<u2").tobytes())
        facts = {"name": name, "label": label, "colour": colour}
        return facts | {"width": width / self.half, "at": at} | more


def surface_scene(mesh: TriangleMesh, up: FloatArray | None) -> dict[str, Any]:
    """A surface as the only layer, seen from its front; without `up`, this is found from the surface."""
    cube, faces = Cube.around(mesh.vertices), encoded(mesh.faces.astype("<u4").tobytes())
    layer = cube.layer("surface", "surface", mesh.vertices, CLAY, width=0, faces=faces)
    axes = body_axes(mesh.vertices, mesh.faces, up).tolist()
    return {"layers": [layer], "on": ["surface"], "axes": axes, "zoom": VIEWER_SIZE}
