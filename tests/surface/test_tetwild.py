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
from pcretrieve.surface.tetwild import remesh, tetrahedralize
from pcretrieve.values import FloatArray, IntArray, Step, TriangleMesh
from pcretrieve.values.topology import defects

BALL = shapes.icosphere(2)

# Of a client that asks for what takes much longer than its test.
ASK_MUCH = """
import numpy as np
from pcretrieve.surface import tetwild
n = 200
angle = 2 * np.pi * np.arange(n) / n
rim = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
vertices = np.concatenate([rim, [[0, 0, 1], [0, 0, -1]]])
after = np.roll(np.arange(n), -1)
up, down = np.full(n, n), np.full(n, n + 1)
faces = np.concatenate([np.stack([np.arange(n), after, up], 1), np.stack([after, np.arange(n), down], 1)])
tetwild.tetrahedralize(
    vertices, faces.astype(np.int32), edge_length=0.01, envelope=0.0005, optimize=True, timeout=600
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
        threads = [
            task.read_text() for task in Path(f"/proc/{process}/task").glob("*/stat")
        ]
    except OSError:  # it ended while we looked
        return runs(process)
    return any(thread.rpartition(")")[2].split()[0] not in "ZX" for thread in threads)


def children(process: int | str = "self") -> list[int]:
    """The processes that a process has started and that are still there."""
    found = [
        int(number)
        for task in Path(f"/proc/{process}/task").glob("*/children")
        for number in task.read_text().split()
    ]
    return [child for child in found if runs(child)]


def busy_child(process: int | str = "self") -> int:
    """The process of fTetWild, once it computes: it has no working directory then."""

    def computes() -> list[int]:
        here = []
        for child in children(process):
            with suppress(OSError):
                if Path(f"/proc/{child}/cwd").readlink().name.endswith(" (deleted)"):
                    here.append(child)
        return here

    assert wait_for(lambda: bool(computes()))
    return computes()[0]


pytestmark = pytest.mark.skipif(
    not Path("/proc/self/stat").exists(), reason="needs /proc to look at processes"
)


# --- answers ------------------------------------------------------------------------------------------


def test_a_ball_is_filled() -> None:
    nodes, tetrahedra = ball()
    assert (nodes.dtype.name, tetrahedra.dtype.name) == ("float64", "int32")
    assert volume(nodes, tetrahedra) == pytest.approx(BALL.volume, rel=0.02)


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


def test_it_is_stopped_when_its_time_is_over() -> None:
    with pytest.raises(
        RemeshError, match=r"fTetWild did not finish within 0\.001 s and was stopped"
    ):
        ball(timeout=0.001)
    assert not children()
    assert len(ball()[1])


def test_its_death_over_a_surface_is_an_error() -> None:
    slow = shapes.ellipsoid(subdivisions=5)
    killer = threading.Thread(target=lambda: os.kill(busy_child(), signal.SIGKILL))
    killer.start()
    with pytest.raises(
        RemeshError, match=r"^\[remesh\] fTetWild died, with exit code -9$"
    ):
        tetrahedralize(
            slow.vertices,
            slow.faces,
            edge_length=0.05,
            envelope=0.001,
            optimize=True,
            timeout=PATIENCE,
        )
    killer.join()


@pytest.mark.slow
def test_ctrl_c_in_the_terminal_is_left_to_its_client() -> None:
    slow = shapes.ellipsoid(subdivisions=4)
    interrupter = threading.Thread(target=lambda: os.kill(busy_child(), signal.SIGINT))
    interrupter.start()
    found = tetrahedralize(
        slow.vertices,
        slow.faces,
        edge_length=0.2,
        envelope=0.001,
        optimize=False,
        timeout=PATIENCE,
    )
    interrupter.join()
    assert len(found[1])


def test_it_ends_with_a_killed_client_and_needs_no_folder(tmp_path: Path) -> None:
    """Isolated, neither of them looks for modules in the folder of the client, which holds some not meant."""
    for name in ("signal", "numpy", "pytetwild", "pcretrieve"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('the wrong module')\n")
    with subprocess.Popen([sys.executable, "-I", "-c", ASK_MUCH], cwd=tmp_path) as client:
        computing = busy_child(client.pid)
        client.kill()
    assert client.returncode == -signal.SIGKILL
    try:
        assert wait_for(lambda: not runs(computing), 5)
    finally:
        with suppress(ProcessLookupError):
            os.kill(computing, signal.SIGKILL)


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
        (
            BODY,
            {"timeout": 1e-3},
            r"fTetWild did not finish within 0\.001 s and was stopped",
        ),
        # For a body that is oriented inwards the result is almost empty, or oriented outwards.
        (
            TriangleMesh(BODY.vertices, BODY.faces[:, ::-1]),
            {},
            r"fTetWild gave no|it changed the",
        ),
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
    message = r"the surface has defects \(3 boundary edges\) and could not be remeshed: fTetWild did not"
    with pytest.raises(RemeshError, match=message):
        remesh(pricked, RemeshOptions(method="tetwild", timeout=1e-3))
