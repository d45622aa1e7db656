"""Time the spectral core on one thread, against LaPy, on the same meshes in the same run.

    .venv/bin/pip install -e '.[benchmark]'
    scripts/benchmark spectral --data FOLDER

needs the set `tosca` in the folder; without it, all meshes are bumpy spheres. Runs of pcretrieve and of LaPy
alternate, so that other load on the machine affects both. It takes about 5 minutes.
"""

from __future__ import annotations

import multiprocessing
import resource
import statistics
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.linalg import eigh
from scipy.sparse.linalg import eigsh
from threadpoolctl import threadpool_limits

from benchmarks.measuring import (
    Column,
    Table,
    add_data,
    argument_parser,
    print_lines,
    timed,
    timed_by_turns,
)
from benchmarks.sets import read_mesh
from benchmarks.synthetic import bumpy_sphere, quartered, unit_square
from pcretrieve.descriptors import r_bihdm
from pcretrieve.spectral import eigenpairs, laplace_beltrami
from pcretrieve.values import FloatArray, IntArray, TriangleMesh

__all__ = ["main", "square_errors"]

N_PAIRS = 61
N_REPEATS = 5
SIZES = (5_000, 20_000, 80_000)
LARGE = 250_000
SQUARES = (3, 5, 8, 12)
TOSCA = ("cat0", "david0")
GIB = 1 << 30

Boundary = Literal["neumann", "dirichlet"]

TABLE = Table(
    Column("mesh", 14, align="<"),
    Column("n", 7),
    Column("LaPy, s", 9, ".3f"),
    Column("ours, s", 9, ".3f"),
    Column("ratio", 7, ".2f"),
    Column("LaPy err", 10, ".1e"),
    Column("our err", 10, ".1e"),
    Column("residual", 10, ".1e"),
)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the figures."""
    parser = argument_parser(__doc__)
    add_data(parser)
    parser.add_argument(
        "--part", choices=PARTS, action="append", help="only this part; may be repeated"
    )
    given = parser.parse_args(arguments)
    with threadpool_limits(1):
        for part in given.part or PARTS:
            print_lines(PARTS[part](given.data / "tosca"))


def _against_lapy(folder: Path) -> Iterator[str]:
    """61 pairs from the mesh, matrices included; errors against ARPACK at full precision."""
    yield f"{N_PAIRS} pairs"
    yield TABLE.head
    for name, mesh in _meshes(folder):
        operator = laplace_beltrami(mesh)
        stiffness, mass, shift = operator.stiffness, operator.mass, -1 / operator.area
        reference = np.sort(
            eigsh(stiffness, N_PAIRS, mass, shift, return_eigenvectors=False)
        )[1:]
        residual = eigenpairs(operator, N_PAIRS).largest_residual
        solvers = [
            partial(lapy_eigenvalues, mesh.vertices, mesh.faces, N_PAIRS),
            partial(our_eigenvalues, mesh),
        ]
        (their_times, their_values), (our_times, our_values) = timed_by_turns(
            solvers, N_REPEATS
        )
        theirs, ours = statistics.median(their_times), statistics.median(our_times)
        errors = [
            np.abs(values[1:] / reference - 1).max()
            for values in (their_values, our_values)
        ]
        yield TABLE.row(
            name, len(mesh.vertices), theirs, ours, theirs / ours, *errors, residual
        )


def _meshes(folder: Path) -> Iterator[tuple[str, TriangleMesh]]:
    """Meshes of about 5, 20 and 80 thousand vertices, by name."""
    for n in SIZES:
        yield "bumpy sphere", bumpy_sphere(n)
    if folder.is_dir():
        for name in TOSCA:
            mesh = read_mesh(folder / f"{name}.off")
            for _ in SIZES:
                yield name, mesh
                mesh = quartered(mesh)


def lapy_eigenvalues(vertices: FloatArray, faces: IntArray, n_pairs: int) -> FloatArray:
    """(n_pairs,) eigenvalues by linear elements of LaPy, an extra; ascending, unit length⁻².

    Reuter, Wolter and Peinecke, "Laplace–Beltrami spectra as 'Shape-DNA' of surfaces and solids",
    Computer-Aided Design 2006.
    """
    from lapy import Solver, TriaMesh

    values, _ = Solver(TriaMesh(vertices, faces)).eigs(n_pairs)
    return np.asarray(values, dtype=np.float64)


def our_eigenvalues(mesh: TriangleMesh) -> FloatArray:
    return eigenpairs(laplace_beltrami(mesh), N_PAIRS).eigenvalues


def _large(_: Path) -> Iterator[str]:
    """Time and peak memory of a large surface, in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mesh.npz"
        mesh = bumpy_sphere(LARGE)
        np.savez(path, vertices=mesh.vertices, faces=mesh.faces)
        with ProcessPoolExecutor(
            1, mp_context=multiprocessing.get_context("spawn")
        ) as pool:
            seconds, peak, residual = pool.submit(_large_run, path).result()
    yield (
        f"{LARGE} vertices, {N_PAIRS} pairs: {seconds:.1f} s, peak {peak:.2f} GiB, residual {residual:.1e}"
    )


def _large_run(path: Path) -> tuple[float, float, float]:
    """Seconds, peak resident memory of this process (GiB), largest residual."""
    with np.load(path) as arrays:
        mesh = TriangleMesh(arrays["vertices"], arrays["faces"])
    with threadpool_limits(1):
        seconds, pairs = timed(lambda: eigenpairs(laplace_beltrami(mesh), N_PAIRS))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / GIB
    return seconds, peak, pairs.largest_residual


def _signature(folder: Path) -> Iterator[str]:
    """From the vertices and faces of a mesh of 5000 vertices to r-bihdm."""
    mesh = (
        read_mesh(folder / f"{TOSCA[0]}.off")
        if folder.is_dir()
        else bumpy_sphere(SIZES[0])
    )

    def run() -> FloatArray:
        checked = TriangleMesh(mesh.vertices, mesh.faces)
        return r_bihdm(eigenpairs(laplace_beltrami(checked), N_PAIRS)).values

    run()  # the first call compiles
    ((times, _),) = timed_by_turns([run], 2 * N_REPEATS)
    yield (
        f"mesh of {len(mesh.vertices)} vertices -> r-bihdm: median {statistics.median(times):.3f} s, "
        f"best {min(times):.3f} s"
    )


def _square(_: Path) -> Iterator[str]:
    """Cubic elements where the eigenvalue is known."""
    yield "cubic elements, flat unit square, λ_1"
    boundaries: tuple[Boundary, ...] = ("neumann", "dirichlet")
    for boundary in boundaries:
        errors, orders = square_errors(SQUARES, boundary)
        for n, error, order in zip(
            SQUARES, errors, ("", *(f"order {o:.2f}" for o in orders)), strict=True
        ):
            yield f"{boundary:<10} {(n + 1) ** 2:>4} vertices  error {error:.1e}  {order}"


def square_errors(
    cells: tuple[int, ...], boundary: Boundary
) -> tuple[FloatArray, FloatArray]:
    """Errors of λ₁ by cubic elements on the unit square, and their order of convergence."""
    errors = []
    for n in cells:
        operator = laplace_beltrami(unit_square(n), "cubic", boundary=boundary)
        # LAPACK, because the smallest square has fewer unknowns than the iteration needs, and because
        # rounding errors must be smaller than the errors of the elements.
        values = eigh(
            operator.stiffness.toarray(), operator.mass.toarray(), eigvals_only=True
        )
        first, exact = (1, np.pi**2) if boundary == "neumann" else (0, 2 * np.pi**2)
        errors.append(values[first] / exact - 1)
    orders = -np.diff(np.log(errors)) / np.diff(np.log(cells))
    return np.array(errors), orders


PARTS: dict[str, Callable[[Path], Iterator[str]]] = {
    "eigenpairs": _against_lapy,
    "large": _large,
    "signature": _signature,
    "square": _square,
}
