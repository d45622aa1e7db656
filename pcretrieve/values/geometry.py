"""Points and surfaces, with the record of their processing."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pcretrieve.arrays import FloatArray, IntArray, area_vectors, bounding_diagonal
from pcretrieve.errors import InputError
from pcretrieve.values.base import Value, numbers

if TYPE_CHECKING:
    from scipy.sparse import csr_array
    from typing_extensions import Self

    from pcretrieve.draw.pictures import Thumbnail

# Smallest ratio of the area of a face to the square of its longest edge. Below it cotangents of the angles
# exceed 1e8, and rounding errors of the stiffness matrix reach the size of its small eigenvalues.
SMALLEST_ASPECT = 1e-9

# Tolerance of the length of unit normals: files store them in single precision, and averages are not exact.
UNIT_TOLERANCE = 1e-3

# Distance of the conventional sensor of range scanners, in diagonals of the view: rays are nearly parallel.
SENSOR_DISTANCE = 10.0


@dataclass(frozen=True, slots=True)
class Step:
    """The record of one stage of the processing of one shape.

    Attributes
    ----------
    stage : str
        Name of the stage.
    seconds : float
        Wall-clock time.
    sizes : dict of str to float
        Counts, and lengths in the unit of the file.
    notes : tuple of str
        A sentence for each repair and each fallback, with its size. Empty if there was none.
    """

    stage: str
    seconds: float
    sizes: dict[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


class _Processed(Value):
    """Base class of values that know the stages that made them."""

    __slots__ = ()
    provenance: tuple[Step, ...]

    @property
    def up(self) -> FloatArray | None:
        """(3,) unit normal of the ground that `crop` removed, towards the body; None if it removed none."""
        for step in self.provenance:
            if step.stage == "crop" and "up_x" in step.sizes:
                return np.array([step.sizes[f"up_{axis}"] for axis in "xyz"])
        return None

    def after(self, step: Step) -> Self:
        """The same value with one more step in its provenance."""
        return replace(self, provenance=(*self.provenance, step))  # type: ignore[type-var]

    def to_trimesh(self) -> Any:
        """The same as a value of trimesh."""
        raise NotImplementedError

    def show(self) -> Any:
        """The shape in 3-D, to turn, in a notebook: an ``IPython.display.HTML`` by the viewer of trimesh."""
        import trimesh
        from trimesh.viewer.notebook import scene_to_notebook

        from pcretrieve.draw.pictures import CLAY

        shape = self.to_trimesh()
        # Points without a colour are white, on white.
        shape.visual.vertex_colors = [*CLAY, 1.0]
        return scene_to_notebook(trimesh.Scene(shape))  # type: ignore[no-untyped-call]


@dataclass(frozen=True, slots=True, eq=False)
class PointCloud(_Processed):
    """A point cloud, in the unit of the file.

    Parameters
    ----------
    points : (n, 3) float64
        Coordinates.
    normals : (n, 3) float64 or None
        Unit normals that point out of the body.
    viewpoints : (n, 3) float64 or None
        Position of the sensor that measured each point, in the frame of the points. A (3,) array is the
        position of one sensor for all points.
    provenance : tuple of Step
        The stages that made the cloud, in order.
    """

    points: FloatArray
    normals: FloatArray | None = None
    viewpoints: FloatArray | None = None
    provenance: tuple[Step, ...] = field(default=(), compare=False)

    def __post_init__(self) -> None:
        n = len(self._lock("points", (None, 3)))
        if self.normals is not None:
            off = (
                np.abs(np.sqrt(self._lock("normals", (n, 3)) ** 2 @ np.ones(3)) - 1)
                > UNIT_TOLERANCE
            )
            if off.any():
                raise InputError(
                    f"normals must have unit length, got {off.sum()} of {n} that have not: "
                    "divide them by their length, or leave them out"
                )
        if self.viewpoints is not None:
            viewpoints = numbers("viewpoints", self.viewpoints)
            if viewpoints.shape == (3,):
                object.__setattr__(
                    self, "viewpoints", np.broadcast_to(viewpoints, (n, 3))
                )
            self._lock("viewpoints", (n, 3))

    @property
    def diagonal(self) -> float:
        """Diagonal of the axis-aligned bounding box, to which relative lengths in options refer."""
        return bounding_diagonal(self.points)

    def select(self, index: NDArray[Any]) -> PointCloud:
        """The points at `index` (a mask or positions), with their normals and viewpoints."""
        normals = None if self.normals is None else self.normals[index]
        viewpoints = None if self.viewpoints is None else self.viewpoints[index]
        return replace(
            self, points=self.points[index], normals=normals, viewpoints=viewpoints
        )

    def to_open3d(self, *, tensor: bool = False) -> Any:
        """An ``open3d.geometry.PointCloud``, or ``open3d.t``'s, with points and normals only."""
        from pcretrieve.arrays.open3d import open3d_cloud

        return open3d_cloud(self.points, self.normals, tensor=tensor)

    def to_trimesh(self) -> Any:
        """A ``trimesh.PointCloud`` with the points; normals and sensor positions are left out."""
        import trimesh

        return trimesh.PointCloud(self.points.copy())  # type: ignore[no-untyped-call]

    def plot(self, axes: Any = None) -> Any:
        """Draw the points by matplotlib (the extra ``plot``), into `axes` of a 3-D plot or a new figure."""
        from pcretrieve.draw.plot import plot_points

        return plot_points(self.points, axes)

    def __repr__(self) -> str:
        parts = [f"{len(self.points):,} points"]
        parts += ["normals"] if self.normals is not None else []
        parts += ["sensor positions"] if self.viewpoints is not None else []
        return f"PointCloud({', '.join(parts)}; diagonal {self.diagonal:.4g} file units)"

    def _repr_html_(self) -> str:
        from pcretrieve.draw.pictures import cloud_thumbnail, picture_html

        return picture_html(
            cloud_thumbnail(self.points) if len(self.points) else None, repr(self)
        )


@dataclass(frozen=True, slots=True, eq=False)
class TriangleMesh(_Processed):
    """A triangulated surface, in the unit of the file.

    Parameters
    ----------
    vertices : (n, 3) float64
        Coordinates.
    faces : (m, 3) int32
        Vertex numbers of each triangle, counter-clockwise seen from outside.
    provenance : tuple of Step
        The stages that made the surface, in order.

    Attributes
    ----------
    others : tuple of TriangleMesh
        The further surfaces that `reconstruct` made of the same scan, over which `signature` takes the mean.
        A changed copy, as by `dataclasses.replace`, has none, because they are not changed with it.
    """

    vertices: FloatArray
    faces: IntArray
    provenance: tuple[Step, ...] = field(default=(), compare=False)
    others: tuple[TriangleMesh, ...] = field(init=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "others", ())
        vertices, faces = (
            self._lock("vertices", (None, 3)),
            self._lock("faces", (None, 3), np.int32),
        )
        if faces.size and not (faces.min() >= 0 and faces.max() < len(vertices)):
            raise InputError(
                f"faces must name vertices 0 to {len(vertices) - 1}, got {faces.min()} to {faces.max()}"
            )

    def __reduce__(self) -> tuple[Any, ...]:
        return with_others, (self.vertices, self.faces, self.provenance, self.others)

    @property
    def diagonal(self) -> float:
        """Diagonal of the axis-aligned bounding box."""
        return bounding_diagonal(self.vertices)

    @property
    def corners(self) -> FloatArray:
        """(3, 3, m) coordinates of the corners of the faces: coordinate, corner, face; rows without gaps."""
        return np.take(
            np.ascontiguousarray(self.vertices.T),
            np.ascontiguousarray(self.faces.T),
            axis=1,
        )

    @property
    def area_vectors(self) -> FloatArray:
        """(m, 3) area vectors: outward normals of the faces, with the area as their length; unit length².

        The area vectors of a closed surface sum up to zero.
        """
        return area_vectors(self.vertices, self.faces)

    @property
    def face_areas(self) -> FloatArray:
        """(m,) areas of the faces, unit length²."""
        return np.sqrt(self.area_vectors**2 @ np.ones(3))

    @property
    def flat_faces(self) -> NDArray[np.bool_]:
        """(m,) mask of degenerate faces, whose area is too small for the gradients of linear elements."""
        squares = (np.diff(self.corners[:, [0, 1, 2, 0]], axis=1) ** 2).sum(
            axis=0
        )  # (3, m)
        return np.asarray(self.face_areas <= SMALLEST_ASPECT * squares.max(axis=0))

    @property
    def area(self) -> float:
        """Total area, unit length²."""
        return float(self.face_areas.sum())

    @property
    def volume(self) -> float:
        """Signed enclosed volume, unit length³; positive if the faces are oriented outwards.

        Meaningful for closed surfaces only.
        """
        corner = self.vertices[self.faces[:, 0]] - self.vertices.mean(axis=0)
        return float(np.einsum("ij,ij->", corner, self.area_vectors) / 3)

    @property
    def euler_characteristic(self) -> int:
        """V − E + F, without unreferenced vertices: 2 for a sphere, 0 for a torus."""
        heads = self.faces[:, [1, 2, 0]]
        low, high = np.minimum(self.faces, heads), np.maximum(self.faces, heads)
        # One number for each edge. np.unique counts by a hash table, which took seven times as long.
        edges = np.sort(low * np.int64(len(self.vertices)) + high, axis=None)
        n_edges = np.count_nonzero(np.diff(edges, prepend=-1))
        n_vertices = np.count_nonzero(np.bincount(self.faces.ravel()))
        return int(n_vertices - n_edges + len(self.faces))

    def to_open3d(self, *, tensor: bool = False) -> Any:
        """An ``open3d.geometry.TriangleMesh``, or ``open3d.t``'s, with the same vertices and faces."""
        from pcretrieve.arrays.open3d import open3d_mesh

        return open3d_mesh(self.vertices, self.faces, tensor=tensor)

    def to_trimesh(self) -> Any:
        """A ``trimesh.Trimesh`` with the same vertices and faces, in the same order."""
        import trimesh

        return trimesh.Trimesh(self.vertices.copy(), self.faces.copy(), process=False)

    def plot(self, axes: Any = None) -> Any:
        """Draw the surface by matplotlib (the extra ``plot``), into `axes` of a 3-D plot or a new figure."""
        from pcretrieve.draw.plot import plot_surface

        return plot_surface(self.vertices, self.faces, axes)

    def thumbnail(self, up: str | FloatArray | None = None) -> Thumbnail | None:
        """A picture from the front, and the direction upwards in it; None without area.

        up: (3,), or an axis such as ``-y``; by default that of the ground, or else found by the form.
        """
        from pcretrieve.draw.axes import upward
        from pcretrieve.draw.pictures import thumbnail

        chosen = upward(up) if isinstance(up, str) else up
        return thumbnail(
            self.vertices, self.faces, up=self.up if chosen is None else chosen
        )

    def __repr__(self) -> str:
        size = f"{len(self.vertices):,} vertices, {len(self.faces):,} faces"
        return f"TriangleMesh({size}; area {self.area:.4g} file units²)"

    def _repr_html_(self) -> str:
        from pcretrieve.draw.pictures import picture_html

        drawn = self.thumbnail()
        return picture_html(None if drawn is None else drawn.png, repr(self))


def with_others(
    vertices: FloatArray,
    faces: IntArray,
    provenance: tuple[Step, ...],
    others: tuple[TriangleMesh, ...],
) -> TriangleMesh:
    """The first surface of a scan, which carries the others."""
    mesh = TriangleMesh(vertices, faces, provenance)
    object.__setattr__(mesh, "others", others)
    return mesh


def adjacency(mesh: TriangleMesh) -> csr_array:
    """(n, n) matrix with 1 for each two vertices that share an edge."""
    from scipy.sparse import csr_array

    starts, ends = mesh.faces.ravel(), mesh.faces[:, [1, 2, 0]].ravel()
    both = np.concatenate([starts, ends]), np.concatenate([ends, starts])
    links: csr_array[np.float64] = csr_array(
        (np.ones(2 * len(starts)), both), 2 * (len(mesh.vertices),)
    )
    links.data[:] = 1.0  # instead of the number of faces at an edge
    return links


def edge_graph(mesh: TriangleMesh) -> csr_array:
    """(n, n) lengths of the edges."""
    links = adjacency(mesh).tocoo()
    starts, ends = links.coords
    # A link of length 0 would be none: scipy leaves zeros of sparse matrices out of a graph.
    least = np.finfo(np.float64).eps * mesh.diagonal
    links.data = np.maximum(
        np.linalg.norm(mesh.vertices[starts] - mesh.vertices[ends], axis=1), least
    )
    return links.tocsr()


def polygon_triangles(polygons: Iterable[NDArray[Any]]) -> NDArray[np.int64]:
    """(m, 3) triangles of polygons, as fans around their first corners.

    polygons: iterable of (p, k) int, vertex numbers of polygons of k corners; fewer than three are ignored.
    """
    triangles = [
        corners if corners.shape[1] == 3 else corners[:, [0, k, k + 1]]
        for corners in polygons
        for k in range(1, corners.shape[1] - 1)
    ]
    return np.concatenate(
        [np.empty((0, 3), np.int64), *triangles], dtype=np.int64, casting="unsafe"
    )


def strip_triangles(corners: NDArray[Any]) -> NDArray[np.int64]:
    """(m, 3) triangles of strips: (k,) vertex numbers, in which −1 ends a strip."""
    corners = corners.astype(np.int64)
    k = np.arange(len(corners))
    # Every second triangle of a strip has the opposite orientation.
    is_odd = (k - np.maximum.accumulate(np.where(corners < 0, k + 1, 0)))[:-2] % 2 == 1
    triangles = np.column_stack([corners[:-2], corners[1:-1], corners[2:]])
    triangles[is_odd] = triangles[is_odd][:, [0, 2, 1]]
    return triangles[(triangles >= 0).all(axis=1)]


def welded(
    points: NDArray[Any], faces: NDArray[np.integer]
) -> tuple[NDArray[Any], NDArray[np.integer]]:
    """Merge the vertices that coincide at the ends of open edges, which have one face.

    STL repeats the vertices of each triangle, other formats those at seams of normals and textures. Vertices
    that coincide without such an edge in common are of parts that touch, and stay apart.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n = len(points)
    # (m, 3), one number for each edge.
    sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]], axis=-1) @ (n, 1)
    edges, use = np.unique(sides, return_counts=True)
    ends = np.column_stack(np.divmod(edges[use == 1], n))  # (s, 2)
    if not len(ends):
        return points, faces
    order = np.lexsort(points.T)
    place = np.empty(n, dtype=np.int64)
    place[order] = (
        np.cumsum(np.diff(points[order], axis=0, prepend=np.nan).any(axis=1)) - 1
    )
    at = place[ends]  # (s, 2)
    _, edge = np.unique(np.sort(at, axis=1) @ (n, 1), return_inverse=True)  # (s,)
    # A graph of the vertices, and of the two ends of each edge in space, which are theirs.
    end = n + 2 * edge[:, None] + (at == at.max(axis=1, keepdims=True))  # (s, 2)
    pairs, size = (ends.ravel(), end.ravel()), int(end.max()) + 1
    graph = coo_array((np.ones(ends.size, np.int8), pairs), shape=(size, size))
    # (n,), numbered in the order of the file.
    merged = connected_components(graph, directed=False)[1][:n]
    first = np.flatnonzero(np.diff(np.maximum.accumulate(merged), prepend=-1))
    return points[first], merged[faces]
