"""Surface → boundary of a tetrahedral mesh by fTetWild (pytetwild), in a process with a time limit.

fTetWild holds the global interpreter lock during a call and has no time limit of its own. Each surface
therefore gets a process, which is killed if it exceeds the limit, and ends with its client. To start one
takes a second, a surface at least eleven.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import tempfile
import time
from importlib import import_module
from importlib.metadata import distribution
from pathlib import Path
from types import ModuleType

import numpy as np

from pcretrieve.errors import RemeshError, ShapeError
from pcretrieve.options import RemeshOptions
from pcretrieve.values import FloatArray, IntArray, Step, TriangleMesh
from pcretrieve.values.compiled import end_with_parent
from pcretrieve.values.repair import repaired
from pcretrieve.values.topology import compact, defects, edges_of, face_groups

# The faces of a tetrahedron of positive volume, counter-clockwise seen from outside.
OUTWARD_FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def remesh(
    mesh: TriangleMesh, options: RemeshOptions, *, optimize: bool = False
) -> TriangleMesh:
    """The boundary of the tetrahedral mesh that fTetWild generates inside a surface.

    The boundary is used if, after repair, it is a closed manifold, and its area and volume differ by at most
    ``options.max_change`` from those of the input (if the input has holes, only the area is compared).
    Otherwise the input is returned, with the reason in its provenance.

    optimize: optimise the quality of the tetrahedra; slow, without benefit for the signature.
    """
    if options.method == "none":
        return mesh
    started = time.perf_counter()
    try:
        nodes, tetrahedra = tetrahedralize(
            mesh.vertices,
            mesh.faces,
            edge_length=options.edge_length,
            envelope=options.envelope,
            optimize=optimize,
            timeout=options.timeout,
        )
        result, notes = repaired(compact(nodes, boundary_faces(nodes, tetrahedra)))
        _check_change(mesh, result, options.max_change)
    except ShapeError as error:
        if found := defects(mesh):
            raise RemeshError(
                f"the surface has defects ({found}) and could not be remeshed: {error.message}"
            ) from error
        result, notes = (
            mesh,
            (f"kept the surface as it was before remeshing: {error.message}",),
        )
    step = Step(
        "remesh",
        time.perf_counter() - started,
        {"faces_in": len(mesh.faces), "faces": len(result.faces)},
        notes,
    )
    return TriangleMesh(result.vertices, result.faces, (*mesh.provenance, step))


def boundary_faces(nodes: FloatArray, tetrahedra: IntArray) -> IntArray:
    """The boundary of (q, 4) tetrahedra in any orientation: the faces of exactly one, outside in front."""
    a, b, c, d = (nodes[tetrahedra[:, k]] for k in range(4))
    negative = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) < 0  # (q,)
    corners = np.where(negative[:, None], tetrahedra[:, [0, 2, 1, 3]], tetrahedra)
    faces = corners[:, OUTWARD_FACES].reshape(-1, 3)  # (4q, 3)
    group = face_groups(faces)
    return np.asarray(faces[np.bincount(group)[group] == 1], dtype=np.int32)


def _check_change(before: TriangleMesh, after: TriangleMesh, most: float) -> None:
    if found := defects(after):
        raise RemeshError(f"its surface has defects: {found}")
    sizes = [("area", before.area, after.area)]
    if not (edges_of(before.faces).use == 1).any():
        sizes.append(("volume", before.volume, after.volume))
    for name, old, new in sizes:
        if abs(new - old) > most * abs(old):
            raise RemeshError(
                f"it changed the {name} from {old:.6g} to {new:.6g}, by more than {most:.0%}"
            )


# The process has the sys.path of its client, instead of one that depends on the working directory.
ANSWER = "import sys; sys.path[:] = sys.argv[1:]; from pcretrieve.surface.tetwild import answer; answer()"


def tetrahedralize(
    vertices: FloatArray,
    faces: IntArray,
    *,
    edge_length: float,
    envelope: float,
    optimize: bool,
    timeout: float,
) -> tuple[FloatArray, IntArray]:
    """Generate a tetrahedral mesh inside a surface [1]_.

    The result is not deterministic, because fTetWild takes its seed from the operating system. For a surface
    that is oriented inwards it is a mesh of a few nodes, without an error.

    timeout: time limit; seconds.
    Returns nodes, tetrahedra: (p, 3) coordinates, and (q, 4) node numbers.

    References
    ----------
    .. [1] Hu, Schneider, Wang, Zorin and Panozzo, "Fast tetrahedral meshing in the wild", ACM TOG 2020.
    """
    settings = {
        "edge_length_fac": edge_length,
        "epsilon": envelope,
        "optimize": optimize,
        "num_threads": 1,
    }
    places = [str(Path(place).resolve()) for place in sys.path]
    try:
        done = subprocess.run(
            [sys.executable, "-c", ANSWER, *places],
            input=pickle.dumps((vertices, faces, settings)),
            stdout=subprocess.PIPE,
            timeout=timeout,
        )
    except subprocess.TimeoutExpired as error:
        raise RemeshError(
            f"fTetWild did not finish within {timeout:g} s and was stopped"
        ) from error
    if done.returncode or not done.stdout:
        raise RemeshError(f"fTetWild died, with exit code {done.returncode}")
    found = pickle.loads(done.stdout)
    if isinstance(found, str):
        raise RemeshError(f"fTetWild failed: {found}")
    nodes, tetrahedra = found
    if not len(tetrahedra):
        raise RemeshError("fTetWild gave no tetrahedra")
    return nodes, tetrahedra


def _library() -> ModuleType:
    """The functions of arrays of pytetwild; its own ``__init__`` imports PyVista and VTK, for others."""
    sys.modules["pytetwild"] = package = ModuleType("pytetwild")
    package.__path__ = [str(distribution("pytetwild").locate_file("pytetwild"))]
    return import_module("pytetwild.pytetwild")


def answer() -> None:
    """Read a surface from standard input, and write its tetrahedra to standard output."""
    # The terminal sends Ctrl-C to this process too, but the client handles it, and ends this one. The signal
    # is blocked instead of ignored, because fTetWild resets the handlers of signals.
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    # A client that exceeded its own time limit is killed, and cannot stop this process.
    end_with_parent()
    # fTetWild prints from C++ to the descriptors 1 and 2, which are redirected. Python's errors are still
    # shown.
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    sys.stderr = os.fdopen(os.dup(sys.stderr.fileno()), "w")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(nowhere, stream)
    # fTetWild writes files into the working directory, which it cannot if the directory was removed.
    folder = Path(tempfile.mkdtemp(prefix="pcretrieve-"))
    os.chdir(folder)
    folder.rmdir()
    vertices, faces, settings = pickle.load(sys.stdin.buffer)
    found: tuple[FloatArray, IntArray] | str
    try:
        nodes, tetrahedra = _library().tetrahedralize(vertices, faces, **settings)
        found = nodes.astype(np.float64), tetrahedra.astype(np.int32)
    except (RuntimeError, ValueError, TypeError) as error:
        found = str(error)
    with answers:
        pickle.dump(found, answers)
