"""Labelled sets of meshes: a folder for each, with the meshes and their classes in ``labels.csv``."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from trimesh.remesh import subdivide

from benchmarks.measuring import progress
from benchmarks.poses import POSES
from benchmarks.simulation import RigOptions, body, make_subject, scan, write_ply
from benchmarks.uniform import UniformOptions, scan_uniformly
from pcretrieve import ingest
from pcretrieve.arrays import vertex_normals
from pcretrieve.catalogue import Catalogue
from pcretrieve.descriptors import DESCRIPTORS, describe
from pcretrieve.errors import BenchmarkError, ShapeError
from pcretrieve.formats import read_scan, write_cloud, write_mesh
from pcretrieve.gallery.fitted import signatures
from pcretrieve.ingestion.discover import discover
from pcretrieve.ingestion.labels import LAYOUTS, read_labels
from pcretrieve.ingestion.run import Summary
from pcretrieve.options import PipelineOptions, SignatureOptions
from pcretrieve.values import FloatArray, IntArray, Metric, SignatureTable, TriangleMesh

N_SUBJECTS = 10
HUMAN_POSES = (
    *("stand", "walk", "sit", "reach_up", "bow"),
    *("hands_on_hips", "hands_clasped", "legs_crossed", "crouch", "arms_crossed"),
)

Thing = TypeVar("Thing")


class Item(NamedTuple):
    """A clean mesh of a set."""

    number: int
    name: str
    label: str
    mesh: TriangleMesh


def left_out(part: str, folder: Path) -> str | None:
    """The line that is printed for a part of a benchmark if its set is missing."""
    if folder.is_dir():
        return None
    layout = LAYOUTS.get(folder.name)
    published = (
        f"; the set is published at {layout.published}" if layout is not None else ""
    )
    return f"{part}: left out, {folder} is not there{published}"


def read_mesh(path: Path) -> TriangleMesh:
    """Read a mesh of a set."""
    mesh = read_scan(path)
    if not isinstance(mesh, TriangleMesh):
        raise BenchmarkError(f"{path} must hold a mesh, got points without faces")
    return mesh


def to_faces(
    n: int, mesh: TriangleMesh, rng: np.random.Generator | None = None
) -> TriangleMesh:
    """The mesh with n faces, by subdivision and the quadric simplification of Open3D."""
    vertices, faces = mesh.vertices, mesh.faces
    while len(faces) < n:
        vertices, faces = subdivide(vertices, faces)  # type: ignore[no-untyped-call]
    made = TriangleMesh(vertices, faces).to_open3d().simplify_quadric_decimation(n)
    return TriangleMesh(np.asarray(made.vertices), np.asarray(made.triangles))


@contextmanager
def ingested(
    folder: Path,
    path: Path,
    options: PipelineOptions,
    labels: dict[str, str] | None = None,
) -> Iterator[tuple[Catalogue, Summary]]:
    """A new catalogue of all scans of a folder, open while the context lasts."""
    labels = read_labels(folder / "labels.csv") if labels is None else labels
    with Catalogue(path, options, create=True) as catalogue:
        yield catalogue, ingest(folder, catalogue, labels=labels)


def spread(things: Sequence[Thing], n: int | None) -> list[tuple[int, Thing]]:
    """Positions and values of n elements at equal steps, from the first to the last."""
    n = len(things) if n is None else min(n, len(things))
    return [
        (k, things[k])
        for k in np.linspace(0, len(things) - 1, n).round().astype(int).tolist()
    ]


def _tosca(data: Path, limit: int | None) -> list[Item]:
    """The meshes of the set TOSCA."""
    labels = read_labels(data / "tosca" / "labels.csv")
    return [
        Item(number, scan.file.stem, labels[scan.name], read_mesh(scan.file))
        for number, scan in spread(discover([data / "tosca"]), limit)
    ]


def _humans(_: Path, limit: int | None) -> list[Item]:
    """Ten simulated people in ten poses; in half of the poses, parts of the body touch."""
    everybody = [(subject, pose) for subject in range(N_SUBJECTS) for pose in HUMAN_POSES]
    items = []
    for number, (subject, pose) in progress(spread(everybody, limit), "bodies"):
        individual = make_subject("person", np.random.default_rng(subject))
        mesh = body(
            individual, POSES["person"][pose], np.random.default_rng((subject, number))
        )
        items.append(Item(number, f"person{subject}_{pose}", f"person{subject}", mesh))
    return items


SETS: dict[str, Callable[[Path, int | None], list[Item]]] = {
    "tosca": _tosca,
    "humans": _humans,
}
"""Sets of clean meshes by name: functions of the folder of all sets and the number of meshes (None: all)."""


# What writes an item of a set into a folder, and returns its file.
Writer = Callable[[Item, Path], Path]


def write_clean(item: Item, folder: Path) -> Path:
    """Write the mesh of an item."""
    path = folder / f"{item.name}.off"
    write_mesh(item.mesh, path)
    return path


def write_scanned(condition: str, item: Item, folder: Path) -> Path:
    """Write a scan of an item under a condition."""
    rng = np.random.default_rng(item.number)
    return write_scan(folder / item.name, item.mesh, condition, rng)


def written_set(
    items: Sequence[Item], folder: Path, write: Writer = write_clean
) -> dict[str, str]:
    """Write the meshes of a set, or scans of them, that are not there, and return their classes."""
    folder.mkdir(exist_ok=True)
    labels = {}
    for item in progress(items, folder.name):
        written = next(iter(folder.glob(f"{item.name}.*")), None)
        if written is None:
            written = write(item, folder)
        labels[written.name] = item.label
    return labels


def pooled_vectors(path: Path, metric: Metric) -> SignatureTable:
    """The descriptors of SHREC'14 that Chiotellis et al. (ECCV 2016) publish."""
    from scipy.io import loadmat

    arrays = loadmat(path)
    values = np.hstack([arrays["WksPooledMat"], arrays["SihksPooledMat"]])  # (N, 150)
    labels = tuple(str(number) for number in arrays["C"].ravel())
    ids = tuple(f"{number:04}" for number in range(len(labels)))
    return SignatureTable(ids, values, "csd", labels=labels, metric=metric)


def described(
    catalogue: Catalogue, options: SignatureOptions
) -> tuple[SignatureTable, dict[str, str | None]]:
    """The signatures of all shapes from what is stored of them, and the classes of shapes that have none."""
    values: dict[str, FloatArray] = {}
    descriptor = DESCRIPTORS[options.method]
    failed = {record.id: record.label for record in catalogue.records()}
    for shape_id in signatures(catalogue).ids:
        with suppress(ShapeError):  # counts as a miss
            values[shape_id] = describe(
                catalogue.shape(shape_id, descriptor.needs), options
            ).values
    labels = tuple(failed.pop(shape_id) for shape_id in values)
    table = SignatureTable(
        tuple(values),
        np.array([*values.values()]),
        options.method,
        labels=labels,
        metric=descriptor.metric,
    )
    return table, failed


LEVELS: dict[str, dict[str, Any]] = {
    "easy": {
        "n_points": 100_000,
        "noise": 0.0005,
        "n_holes": 2,
        "hole_radius": 0.01,
        "outlier_share": 0.0,
    },
    "typical": asdict(UniformOptions()),
    "harsh": {
        "n_points": 20_000,
        "noise": 0.003,
        "n_holes": 10,
        "hole_radius": 0.02,
        "outlier_share": 0.01,
    },
}

# The options that cameras add to a level: the number of pixels, which suffices for its points, and flying
# pixels.
CAMERAS: dict[str, dict[str, Any]] = {
    "easy": {"pixels": 400, "flying_share": 0.01},
    "typical": {},
    "harsh": {"flying_share": 0.1},
}
SAMPLINGS = ("uniform", "uniform-sensors", "rig", "rig-sensors")

# The condition that has no points: the clean mesh, damaged.
DEFECTS = "defects"

CONDITIONS = (
    *(f"{level}-{sampling}" for level in LEVELS for sampling in SAMPLINGS),
    DEFECTS,
)
"""Names of the conditions: a level and a way of sampling, or `DEFECTS`."""


def write_scan(
    stem: Path, mesh: TriangleMesh, condition: str, rng: np.random.Generator
) -> Path:
    """Scan a mesh under a condition, and write the scan."""
    if condition == DEFECTS:
        path = stem.with_suffix(".off")
        write_mesh(damaged(mesh, DamageOptions(), rng), path)
        return path
    level, sampling, *sensors = condition.split("-")
    if sampling == "uniform":
        cloud = scan_uniformly(
            mesh, UniformOptions(**LEVELS[level] | {"sensors": bool(sensors)}), rng
        )
    else:
        numbers = {
            name: value for name, value in LEVELS[level].items() if name != "sensors"
        }
        cloud = scan(mesh, RigOptions(**numbers | CAMERAS[level]), rng)
    if sensors:
        path = stem.with_suffix(".pcd")
        write_cloud(cloud, path)
    else:
        path = stem.with_suffix(".ply")
        write_ply(path, cloud.points)
    return path


# --- damage ---------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class DamageOptions:
    """Defects of a mesh. A patch is the set of faces whose centroids lie in a ball round that of one face."""

    n_holes: int = 4
    n_flipped: int = 4
    n_flaps: int = 3
    radius: float = 0.02
    duplicated_share: float = 0.01
    shell_radius: float = 0.15
    shell_depth: float = 0.004


def damaged(
    mesh: TriangleMesh, options: DamageOptions, rng: np.random.Generator
) -> TriangleMesh:
    """Add defects to a mesh at random places. Other parts of the surface do not change."""
    middles = mesh.vertices[mesh.faces].mean(axis=1)  # (m, 3)

    def patch(radius: float) -> NDArray[np.bool_]:
        """A mask of the faces in a patch round a random face, (m,)."""
        centre = middles[rng.integers(len(middles))]
        near: NDArray[np.bool_] = (
            np.linalg.norm(middles - centre, axis=1) <= radius * mesh.diagonal
        )
        return near

    # Flaps and the second surface are copied from the mesh before holes are cut.
    sheets = [
        _turned(mesh.vertices, mesh.faces[patch(options.radius)], rng)
        for _ in range(options.n_flaps)
    ]
    if options.shell_radius > 0:
        depth = options.shell_depth * mesh.diagonal
        beneath = mesh.vertices - depth * vertex_normals(mesh.vertices, mesh.faces)
        sheets.append((beneath, mesh.faces[patch(options.shell_radius)]))
    faces = mesh.faces.copy()
    for _ in range(options.n_flipped):
        flipped = patch(options.radius)
        faces[flipped] = faces[flipped][:, ::-1]
    whole = np.ones(len(faces), dtype=bool)
    for _ in range(options.n_holes):
        whole &= ~patch(options.radius)
    faces = faces[whole]
    twice = faces[
        rng.choice(
            len(faces), round(options.duplicated_share * len(faces)), replace=False
        )
    ]
    twice[::2] = twice[::2, ::-1]
    vertices, parts = [mesh.vertices], [faces, twice]
    for points, sheet in sheets:
        used, number = np.unique(sheet, return_inverse=True)
        parts.append(number.reshape(-1, 3) + sum(map(len, vertices)))
        vertices.append(points[used])
    return TriangleMesh(np.concatenate(vertices), np.concatenate(parts))


def _turned(
    vertices: FloatArray, faces: IntArray, rng: np.random.Generator
) -> tuple[FloatArray, IntArray]:
    """All vertices, rotated at random about the mean vertex of some faces, and these faces."""
    middle = vertices[faces].mean(axis=(0, 1))
    turn = Rotation.from_quat(rng.standard_normal(4)).as_matrix()
    return (vertices - middle) @ turn.T + middle, faces
