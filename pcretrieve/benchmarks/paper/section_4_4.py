"""Section 4.4: how far noise, holes, coarse meshes and another pose move the descriptors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from pcretrieve.benchmarks.paper.spectra import unit_area_spectrum
from pcretrieve.descriptors import describe
from pcretrieve.errors import BenchmarkError
from pcretrieve.options import RemeshOptions, SignatureOptions
from pcretrieve.retrieval.distances import log_signatures, pairwise
from pcretrieve.surface.remesh import remesh
from pcretrieve.surface.repair import largest_component
from pcretrieve.surface.simplify import simplified
from pcretrieve.surface.topology import compact
from pcretrieve.values import FloatArray, Shape, Surface, TriangleMesh

__all__ = ["NOISE", "REMOVED", "drifts", "noisy", "perturbed", "section_4_4", "without_faces"]

N_MODES = 60
N_VALUES = 23

# Standard deviations of the noise in mean edge lengths, and shares of faces that are removed.
NOISE = (0.1, 0.3, 0.5)
REMOVED = (0.01, 0.02, 0.03)

# With optimisation of the tetrahedra: without it, the surface has three times as many faces as the input, and
# many handles.
REMESHING = RemeshOptions(method="tetwild", optimize=True, timeout=600)
METHODS = ("r-bihdm", "bihdm", "shape-dna", "wks", "hks-bow", "combined")

Poses = Mapping[str, tuple[TriangleMesh, TriangleMesh]]


def section_4_4(poses: Poses, *, remeshed: bool = True) -> Iterator[str]:
    """Median and largest drift of each descriptor.

    Parameters
    ----------
    poses : mapping of class to two meshes
        As in `drifts`.
    remeshed : bool, default True
        As in `drifts`.

    Yields
    ------
    str
        A line of the table.
    """
    unit = "1 is the distance to the nearest other class"
    yield f"Section 4.4: drift of log-signatures, L = {N_VALUES}; {unit}"
    yield f"median/largest of {', '.join(poses)}; pose: the second mesh of each class"
    table = drifts(poses, remeshed=remeshed)
    yield f"{'method':<11}" + "".join(f"{name:<12}" for name in table).rstrip()
    for column, method in enumerate(METHODS):
        cells = (f"{np.median(rows[:, column]):.2f}/{rows[:, column].max():.2f}" for rows in table.values())
        yield f"{method:<11}" + "".join(f"{cell:<12}" for cell in cells).rstrip()


def drifts(
    poses: Poses, methods: tuple[str, ...] = METHODS, *, remeshed: bool = True
) -> dict[str, FloatArray]:
    """How far signatures move under each perturbation and, to compare, from one pose to another.

    Parameters
    ----------
    poses : mapping of class to two meshes
        The first mesh is perturbed by random numbers.
    methods : tuple of str
        Names of descriptors; by default `METHODS`.
    remeshed : bool, default True
        Whether the surface of fTetWild is among the perturbations, which takes a minute a mesh.

    Returns
    -------
    dict of str to (shapes, methods) float64
        By the name of the perturbation. The unit is the distance of log-signatures from the first mesh of a
        class to the nearest first mesh of another class: beyond 1, a query may find the wrong class.
    """
    clean = [_signatures(first, methods) for first, _ in poses.values()]
    stacked = [np.array(column) for column in zip(*clean, strict=True)]  # (shapes, L) for each method
    apart = np.array([np.sort(pairwise("log", table, table), axis=1)[:, 1] for table in stacked])
    moved: dict[str, list[FloatArray]] = {}
    for number, (mesh, other_pose) in enumerate(poses.values()):
        changed = [*perturbed(mesh, np.random.default_rng(number), remeshed=remeshed), ("pose", other_pose)]
        for name, variant in changed:
            after = _signatures(variant, methods)
            distance = [np.linalg.norm(b - a) for a, b in zip(clean[number], after, strict=True)]
            moved.setdefault(name, []).append(np.array(distance) / apart[:, number])
    return {name: np.array(rows) for name, rows in moved.items()}


def perturbed(
    mesh: TriangleMesh, rng: np.random.Generator, *, remeshed: bool = True
) -> Iterator[tuple[str, TriangleMesh]]:
    """The perturbations of section 4.4 and two remeshings.

    Parameters
    ----------
    mesh : TriangleMesh
        Closed, oriented outwards.
    rng : numpy.random.Generator
        Of the noise and of the faces that are removed.
    remeshed : bool, default True
        Whether the surface of fTetWild is the last one.

    Yields
    ------
    str, TriangleMesh
        Name of the perturbation, and the perturbed mesh.

    Raises
    ------
    BenchmarkError
        If fTetWild's surface could not be used.
    """
    for size in NOISE:
        yield f"noise {size}", noisy(mesh, size, rng)
    for share in REMOVED:
        yield f"holes {share:.0%}", without_faces(mesh, share, rng)
    yield "half faces", simplified(mesh, len(mesh.faces) // 2)
    if not remeshed:
        return
    surface = remesh(mesh, REMESHING)
    if np.array_equal(surface.faces, mesh.faces):
        raise BenchmarkError(f"fTetWild's surface could not be used: {surface.provenance[-1].notes}")
    yield "fTetWild", surface


def noisy(mesh: TriangleMesh, size: float, rng: np.random.Generator) -> TriangleMesh:
    """A mesh with white noise along the normals of its vertices.

    Parameters
    ----------
    mesh : TriangleMesh
        Oriented outwards.
    size : float
        Standard deviation; mean edge lengths.
    rng : numpy.random.Generator
        Of the noise.

    Returns
    -------
    TriangleMesh
        The mesh after the perturbation.
    """
    corners = mesh.vertices[mesh.faces]  # (m, 3, 3)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])  # (m, 3)
    normals = np.zeros_like(mesh.vertices)
    np.add.at(normals, mesh.faces, across[:, None])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean()
    offsets = size * edge * rng.standard_normal(len(normals))
    return TriangleMesh(mesh.vertices + offsets[:, None] * normals, mesh.faces)


def without_faces(mesh: TriangleMesh, share: float, rng: np.random.Generator) -> TriangleMesh:
    """A mesh of which random faces were removed.

    Parameters
    ----------
    mesh : TriangleMesh
        Any.
    share : float
        Share of the faces that are removed.
    rng : numpy.random.Generator
        Of the faces.

    Returns
    -------
    TriangleMesh
        The largest connected component of what is left.
    """
    kept = np.sort(rng.permutation(len(mesh.faces))[round(share * len(mesh.faces)) :])
    return largest_component(compact(mesh.vertices, mesh.faces[kept]))[0]


def _signatures(mesh: TriangleMesh, methods: tuple[str, ...]) -> list[FloatArray]:
    """Log-signatures of a mesh, one by each method."""
    shape = Shape((Surface(mesh.area, unit_area_spectrum(mesh, N_MODES), mesh),))
    lengths = {"n_values": N_VALUES, "n_modes": N_MODES}
    options = (SignatureOptions(method=method, scale="relative", **lengths) for method in methods)
    return [log_signatures(describe(shape, each).values) for each in options]
