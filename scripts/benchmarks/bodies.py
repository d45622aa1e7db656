"""Bodies of several kinds, in several poses, y up: people, animals, hands, bones and parts of machines."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks import solids
from benchmarks.poses import POSES
from benchmarks.sets import read_mesh
from benchmarks.simulation import body, make_subject
from benchmarks.simulation.samples import moved
from pcretrieve.arrays.open3d import RayScene
from pcretrieve.errors import BenchmarkError
from pcretrieve.ingestion.labels import read_labels
from pcretrieve.retrieval import Positions
from pcretrieve.values import FloatArray, IntArray, TriangleMesh
from pcretrieve.values.geometry import edge_graph
from pcretrieve.values.topology import components

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A closed surface of an individual in a pose; y is up, and people face z.

    places: vertices by the names of `PLACES`; empty if they are not known.
    """

    name: str
    label: str
    mesh: TriangleMesh
    places: dict[str, int] = field(default_factory=dict)


class Sources(NamedTuple):
    """Where bodies come from: the folder of the data sets, that of `make_people --bodies`, and a seed."""

    data: Path
    anny: Path
    seed: int


class Place(NamedTuple):
    """Where a place is on a standing person.

    height, and the least and largest distance from the middle to the left: relative to the height.
    side: 1 on the front, -1 on the back, 0 on top.
    """

    height: float
    across: tuple[float, float]
    side: int


PLACES = {
    "crown": Place(1.0, (0.0, 0.0), 0),
    "face": Place(0.935, (0.0, 0.02), 1),
    "chest": Place(0.74, (0.03, 0.08), 1),
    "back": Place(0.74, (0.03, 0.08), -1),
    "thigh": Place(0.40, (0.02, 0.10), 1),
    "shin": Place(0.17, (0.01, 0.12), 1),
}

# Half the height of the band in which the vertex of a place is looked for, relative to the height.
BAND = 0.015


def standing_places(mesh: TriangleMesh) -> dict[str, int]:
    """The vertices of all places of a person who stands upright and faces z."""
    x, y, z = mesh.vertices.T
    height = float(np.ptp(y))
    crown = int(y.argmax())
    found = {"crown": crown}
    for name, place in PLACES.items():
        if place.side == 0:
            continue
        across = (x - x[crown]) / height
        level = (y - y.min()) / height
        near = (np.abs(level - place.height) < BAND) & (across >= place.across[0])
        near &= across <= place.across[1]
        found[name] = int(np.where(near, place.side * z, -np.inf).argmax())
    return found


# --- people -------------------------------------------------------------------------------------------------


def anny(sources: Sources, n: int, n_poses: int) -> list[list[Body]]:
    """People of Anny, as `make_people --bodies` has written them."""
    folder = sources.anny
    if not (folder / "labels.csv").is_file():
        raise BenchmarkError(
            f"{folder} must hold people of Anny: write them with scripts/make_people --bodies, or take "
            "other people"
        )
    poses: dict[str, list[Path]] = {}
    for file, label in read_labels(folder / "labels.csv").items():
        if (folder / file).is_file():
            poses.setdefault(label, []).append(folder / file)
    standing = [
        path for paths in poses.values() for path in paths if path.stem.endswith("_stand")
    ]
    whole = read_mesh(standing[0])
    seal = skin_of(whole)
    places = standing_places(sealed(whole, seal))
    chosen = [(label, paths) for label, paths in poses.items() if len(paths) >= n_poses][
        :n
    ]
    return [
        [
            Body(path.stem, label, sealed(read_mesh(path), seal), places)
            for path in paths[:n_poses]
        ]
        for label, paths in chosen
    ]


# Directions in which light is looked for, and the least number of hidden faces that are a cavity.
N_RAYS, LEAST_CAVITY = 128, 60

# Cavities are in the head: above this height of a person who stands.
HEAD = 0.87


def skin_of(mesh: TriangleMesh) -> Positions:
    """The faces of the outer skin of a mesh of Anny: without eyes, their sockets and the mouth inside."""
    part = components(mesh)
    skin = part == np.bincount(part).argmax()
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    normals = mesh.area_vectors / mesh.face_areas[:, np.newaxis]
    low, high = mesh.vertices[:, 1].min(), mesh.vertices[:, 1].max()
    hidden = skin & (middles[:, 1] > low + HEAD * (high - low))
    hidden[hidden] = ~is_outside(mesh, middles[hidden], normals[hidden], N_RAYS)
    number = np.flatnonzero(hidden)
    label = components(TriangleMesh(mesh.vertices, mesh.faces[hidden]))
    removed = np.zeros(len(mesh.vertices), dtype=bool)
    removed[mesh.faces[number[np.bincount(label)[label] >= LEAST_CAVITY]]] = True
    while True:
        kept = skin & ~removed[mesh.faces].any(axis=1)
        part = components(TriangleMesh(mesh.vertices, mesh.faces[kept]))
        kept[kept] = part == np.bincount(part).argmax()
        begins = open_edges(mesh.faces[kept])[:, 0]
        # Openings that meet at a vertex are made one.
        shared = np.flatnonzero(np.bincount(begins) > 1)
        if not len(shared):
            return np.flatnonzero(kept)
        removed[shared] = True


def open_edges(faces: IntArray) -> Positions:
    """(k, 2) the edges that have a face on one side only, in its direction."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(
        np.int64
    )
    n = int(edges.max()) + 1
    return edges[~np.isin(edges[:, 0] * n + edges[:, 1], edges[:, 1] * n + edges[:, 0])]


def sealed(mesh: TriangleMesh, skin: Positions) -> TriangleMesh:
    """Some faces of a mesh, whose openings are closed by a vertex in the middle of each."""
    faces = mesh.faces[skin]
    vertices, caps = [mesh.vertices], [faces]
    after = dict(open_edges(faces).tolist())
    while after:
        loop = [next(iter(after))]
        while loop[-1] in after:
            loop.append(after.pop(loop[-1]))
        rim = np.array(loop)
        middle = len(mesh.vertices) + len(vertices) - 1
        vertices.append(mesh.vertices[rim[:-1]].mean(axis=0, keepdims=True))
        caps.append(np.column_stack([rim[1:], rim[:-1], np.full(len(rim) - 1, middle)]))
    return TriangleMesh(np.concatenate(vertices), np.concatenate(caps).astype(np.int32))


def is_outside(
    mesh: TriangleMesh, points: FloatArray, normals: FloatArray, n_rays: int
) -> Mask:
    """(n,) whether some of random rays from points of a surface leave it."""
    scene = RayScene(mesh.vertices, mesh.faces)
    rng = np.random.default_rng(0)
    hidden = np.arange(len(points))
    starts = points + ABOVE * mesh.diagonal * normals
    for _ in range(n_rays):
        ray = rng.standard_normal(3)
        rays = np.where((normals[hidden] @ ray > 0)[:, np.newaxis], ray, -ray)
        hidden = hidden[np.isfinite(scene.cast(starts[hidden], rays)[0])]
        if not len(hidden):
            break
    outside = np.ones(len(points), dtype=bool)
    outside[hidden] = False
    return outside


# Height above a surface from which rays are cast, relative to the diagonal: beyond single precision.
ABOVE = 1e-4


def simulated(sources: Sources, n: int, n_poses: int) -> list[list[Body]]:
    """People of `benchmarks.simulation`."""
    return [
        _individual("person", sources.seed, number, n_poses, standing=True)
        for number in range(n)
    ]


def hands(sources: Sources, n: int, n_poses: int) -> list[list[Body]]:
    """Hands of `benchmarks.simulation`."""
    return [_individual("hand", sources.seed, number, n_poses) for number in range(n)]


# Far from the seeds of the shipped arrays and of the sets.
FIRST_SEED = 4800


def _individual(
    family: str, seed: int, number: int, n_poses: int, *, standing: bool = False
) -> list[Body]:
    rng = np.random.default_rng((FIRST_SEED, seed, number))
    subject = make_subject(family, rng)
    label = f"{family}-{seed}-{number:03}"
    # Parts that touch are another subject: see `damage`, "pair".
    apart = [name for name, pose in POSES[family].items() if not pose.contacts]
    names = rng.permutation(apart)[:n_poses]
    found = [
        (
            str(name),
            body(subject, POSES[family][name], np.random.default_rng((seed, number, k))),
        )
        for k, name in enumerate(names)
    ]
    places = standing_places(body(subject, POSES[family]["stand"])) if standing else {}
    return [Body(f"{label}_{name}", label, mesh, places) for name, mesh in found]


# --- meshes of TOSCA ----------------------------------------------------------------------------------------

PEOPLE = ("david", "michael", "victoria")
ANIMALS = ("cat", "dog", "horse", "wolf", "centaur")

# From z up, with the face along −y, to y up, with the face along z.
UPRIGHT = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])


def _tosca(
    sources: Sources, names: tuple[str, ...], n: int, n_poses: int
) -> list[list[Body]]:
    folder = sources.data / "tosca"
    found = []
    for name in names[:n]:
        paths = sorted(
            folder.glob(f"{name}*.off"), key=lambda path: int(path.stem[len(name) :])
        )
        if not paths:
            raise BenchmarkError(
                f"{folder} must hold the set TOSCA, it has no {name}*.off"
            )
        individual = []
        for path in paths[:n_poses]:
            mesh = read_mesh(path)
            upright = TriangleMesh(moved(UPRIGHT, mesh.vertices), mesh.faces)
            # Only in the first pose do they stand.
            is_standing = path.stem == f"{name}0" and name in PEOPLE
            places = standing_places(upright) if is_standing else {}
            individual.append(Body(path.stem, name, upright, places))
        found.append(individual)
    return found


def tosca_people(sources: Sources, n: int, n_poses: int) -> list[list[Body]]:
    """The people of TOSCA."""
    return _tosca(sources, PEOPLE, n, n_poses)


def animals(sources: Sources, n: int, n_poses: int) -> list[list[Body]]:
    """The animals of TOSCA, and then those of `benchmarks.simulation`."""
    found = _tosca(sources, ANIMALS, n, n_poses)
    more = n - len(found)
    return found + [
        _individual("animal", sources.seed, number, n_poses)
        for number in range(max(more, 0))
    ]


# --- bodies without poses -----------------------------------------------------------------------------------


def _rigid(
    kind: str, make: Callable[..., TriangleMesh]
) -> Callable[..., list[list[Body]]]:
    def made(sources: Sources, n: int, n_poses: int) -> list[list[Body]]:
        """Individuals that lie on one side and then on others."""
        found = []
        for number in range(n):
            mesh = make(np.random.default_rng((FIRST_SEED, sources.seed, number)), number)
            label = f"{kind}-{sources.seed}-{number:03}"
            found.append(
                [
                    Body(f"{label}_side{side}", label, solids.lying(mesh, side))
                    for side in range(n_poses)
                ]
            )
        return found

    return made


bones = _rigid("bone", solids.femur)
parts = _rigid("part", solids.machine_part)

KINDS: dict[str, Callable[[Sources, int, int], list[list[Body]]]] = {
    "people": anny,
    "simulated": simulated,
    "tosca-people": tosca_people,
    "animals": animals,
    "hands": hands,
    "bones": bones,
    "cad": parts,
}
"""Kinds of bodies: functions of sources, the number of individuals, and that of poses of each."""


def neighbourhood(mesh: TriangleMesh, centre: int, radius: float) -> Mask:
    """(n,) whether vertices are in a ball round one of them, and connected with it there."""
    from scipy.sparse.csgraph import connected_components

    inside = np.linalg.norm(mesh.vertices - mesh.vertices[centre], axis=1) < radius
    inside[centre] = True
    rows = np.flatnonzero(inside)
    label = connected_components(edge_graph(mesh)[rows][:, rows], directed=False)[1]
    near = np.zeros(len(inside), dtype=bool)
    near[rows[label == label[np.searchsorted(rows, centre)]]] = True
    return near
