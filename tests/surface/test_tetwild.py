"""Remeshing: fTetWild's result is used only if it is the same body; its server ends with its client."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapes
from processes import PATIENCE, wait_for

from pcretrieve.errors import RemeshError
from pcretrieve.options import RemeshOptions
from pcretrieve.surface import defects, tetwild
from pcretrieve.surface.tetwild import remesh, tetrahedralize
from pcretrieve.values import FloatArray, IntArray, Step, TriangleMesh

BALL = shapes.icosphere(2)

# Of a client that waits with its server idle.
ASK_ONCE = """
import numpy as np
from pcretrieve.surface import tetwild
vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.int32)
tetwild.tetrahedralize(vertices, faces, edge_length=0.5, envelope=0.01, optimize=False, timeout=60)
print(tetwild._server.process().pid, flush=True)
input()
"""


# Of the same client, which then asks for what takes much longer than this test.
ASK_MUCH = """
import shapes
egg = shapes.ellipsoid(subdivisions=5)
tetwild.tetrahedralize(
    egg.vertices, egg.faces, edge_length=0.02, envelope=0.001, optimize=True, timeout=600
)
"""


def ball(
    *, faces: IntArray = BALL.faces, edge_length: float = 0.2, timeout: float = 60.0
) -> tuple[FloatArray, IntArray]:
    return tetrahedralize(
        BALL.vertices,
        faces,
        edge_length=edge_length,
        envelope=0.001,
        optimize=False,
        timeout=timeout,
    )


def volume(nodes: FloatArray, tetrahedra: IntArray) -> float:
    a, b, c, d = (nodes[tetrahedra[:, k]] for k in range(4))
    return float(np.abs(np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a)).sum() / 6)


def runs(process: int) -> bool:
    """Whether a process is there, with any thread that is more than a zombie."""
    try:
        threads = [task.read_text() for task in Path(f"/proc/{process}/task").glob("*/stat")]
    except OSError:  # it ended while we looked
        return runs(process)
    return any(thread.rpartition(")")[2].split()[0] not in "ZX" for thread in threads)


def seconds_of(process: int) -> float:
    """The time of a processor that a process has used."""
    user, system = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[11:13]
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


def own_server() -> int:
    return tetwild._server.process().pid


pytestmark = pytest.mark.skipif(
    not Path("/proc/self/stat").exists(), reason="needs /proc to look at processes"
)


# --- answers ------------------------------------------------------------------------------------------


def test_a_ball_is_filled_and_one_server_answers_again_also_after_ctrl_c_in_the_terminal() -> None:
    nodes, tetrahedra = ball()
    first = own_server()
    assert (nodes.dtype.name, tetrahedra.dtype.name) == ("float64", "int32")
    assert volume(nodes, tetrahedra) == pytest.approx(BALL.volume, rel=0.02)
    os.kill(first, signal.SIGINT)
    assert len(ball()[1])
    assert own_server() == first


@pytest.mark.parametrize(
    ("question", "message"),
    [
        (lambda: ball(faces=BALL.faces[:1]), r"^\[remesh\] fTetWild gave no tetrahedra$"),
        (
            lambda: ball(edge_length=2.0),
            r"^\[remesh\] fTetWild failed: Edge length factor must be between",
        ),
    ],
    ids=["nothing to fill", "refused"],
)
def test_no_answer_is_an_error_and_the_next_one_is_right(
    question: Callable[[], Any], message: str
) -> None:
    with pytest.raises(RemeshError, match=message):
        question()
    assert volume(*ball()) == pytest.approx(BALL.volume, rel=0.02)


# --- death --------------------------------------------------------------------------------------------


def test_it_is_stopped_when_its_time_is_over_and_the_next_one_answers() -> None:
    ball()
    first = own_server()
    with pytest.raises(
        RemeshError, match=r"fTetWild did not finish within 0\.001 s and was stopped"
    ):
        ball(timeout=0.001)
    assert not runs(first)
    assert len(ball()[1])
    assert own_server() != first


def test_its_death_over_a_surface_is_an_error() -> None:
    ball()
    slow = shapes.ellipsoid(subdivisions=5)
    threading.Timer(0.2, lambda: os.kill(own_server(), signal.SIGKILL)).start()
    with pytest.raises(RemeshError, match=r"^\[remesh\] fTetWild died, with exit code -9$"):
        tetrahedralize(
            slow.vertices,
            slow.faces,
            edge_length=0.05,
            envelope=0.001,
            optimize=True,
            timeout=PATIENCE,
        )


@pytest.mark.parametrize("code", [0, -signal.SIGKILL], ids=["exits", "is killed"])
def test_it_ends_with_its_client_and_leaves_no_folder(code: int, tmp_path: Path) -> None:
    """Isolated, neither of them looks for modules in the folder of the client, which holds some not meant."""
    for name in ("signal", "numpy", "pytetwild", "pcretrieve"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('the wrong module')\n")
    command, pipe = [sys.executable, "-I", "-c", ASK_ONCE], subprocess.PIPE
    with subprocess.Popen(command, cwd=tmp_path, stdin=pipe, stdout=pipe, text=True) as client:
        assert client.stdout is not None
        server = int(client.stdout.readline())
        assert Path(f"/proc/{server}/cwd").readlink().name.endswith(" (deleted)")
        if code:
            client.kill()
        client.communicate("\n", timeout=PATIENCE)
    assert client.returncode == code
    assert wait_for(lambda: not runs(server))


@pytest.mark.slow
def test_it_ends_with_a_killed_client_while_it_computes() -> None:
    known = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command, pipe = [sys.executable, "-c", f"{ASK_ONCE}{ASK_MUCH}"], subprocess.PIPE
    with subprocess.Popen(command, env=known, stdin=pipe, stdout=pipe, text=True) as client:
        assert client.stdout is not None and client.stdin is not None
        server = int(client.stdout.readline())
        before = seconds_of(server)
        client.stdin.write("\n")
        client.stdin.flush()
        assert wait_for(lambda: seconds_of(server) > before + 0.1)
        client.kill()
    try:
        assert wait_for(lambda: not runs(server), 5)
    finally:
        with suppress(ProcessLookupError):
            os.kill(server, signal.SIGKILL)


# --- remeshing ----------------------------------------------------------------------------------------

BODY = shapes.body(3)
TETWILD = RemeshOptions(method="tetwild")
KEPT = "kept the surface as it was before remeshing: "


@pytest.mark.parametrize("mesh", [BODY, shapes.torus(24, 12)], ids=["body", "torus"])
def test_a_closed_surface_keeps_topology_area_and_volume(mesh: TriangleMesh) -> None:
    earlier = Step("surface", 1.0)
    result = remesh(mesh.after(earlier), TETWILD)
    assert not defects(result)
    assert result.euler_characteristic == mesh.euler_characteristic
    assert result.area == pytest.approx(mesh.area, rel=0.01)
    assert result.volume == pytest.approx(mesh.volume, rel=0.01)
    first, step = result.provenance
    assert first == earlier
    assert (step.stage, step.sizes) == (
        "remesh",
        {"faces_in": len(mesh.faces), "faces": len(result.faces)},
    )
    assert step.seconds > 0
    assert not any(note.startswith(KEPT) for note in step.notes)


@pytest.mark.parametrize(
    ("mesh", "options", "why"),
    [
        (BODY, {"timeout": 1e-3}, r"fTetWild did not finish within 0\.001 s and was stopped"),
        # For a body that is oriented inwards the result is almost empty, or oriented outwards.
        (TriangleMesh(BODY.vertices, BODY.faces[:, ::-1]), {}, r"fTetWild gave no|it changed the"),
    ],
    ids=["no time", "inside out"],
)
def test_an_answer_that_cannot_be_used_is_refused_and_said_so(
    mesh: TriangleMesh, options: dict[str, float], why: str
) -> None:
    result = remesh(mesh, TETWILD.model_copy(update=options))
    assert (result.vertices == mesh.vertices).all() and (result.faces == mesh.faces).all()
    (note,) = result.provenance[-1].notes
    assert note.startswith(KEPT)
    assert re.match(why, note.removeprefix(KEPT)), note


def test_without_an_answer_a_surface_with_holes_is_an_error() -> None:
    pricked = TriangleMesh(BODY.vertices, BODY.faces[1:])
    message = (
        r"the surface has defects \(3 boundary edges\) and could not be remeshed: fTetWild did not"
    )
    with pytest.raises(RemeshError, match=message):
        remesh(pricked, RemeshOptions(method="tetwild", timeout=1e-3))
