"""fTetWild (pytetwild), in a process of its own that can be killed.

It holds the interpreter lock for its whole run, has no time limit, and takes a second to import: so one
server process is started when first needed, answers one surface after another, and is killed where it
overruns. The server ends with the process that asks it.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import io
import os
import signal
import struct
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from pcretrieve.errors import RemeshError
from pcretrieve.types import FloatArray, IntArray

__all__ = ["serve", "start", "tetrahedralize"]

Arrays = dict[str, NDArray[Any]]

# Messages are .npz archives behind their length: arrays only, nothing that could be executed.
LENGTH = struct.Struct("<q")

# <sys/prctl.h>
PR_SET_PDEATHSIG = 1

# The server finds its modules where its client does, and not in the folder that it happens to be started in.
SERVER = "import sys; sys.path[:] = sys.argv[1:]; from pcretrieve.adapters.tetwild import serve; serve()"


def tetrahedralize(
    vertices: FloatArray,
    faces: IntArray,
    *,
    edge_length: float,
    envelope: float,
    optimize: bool,
    timeout: float,
) -> tuple[FloatArray, IntArray]:
    """Fill a surface with tetrahedra [1]_.

    Not deterministic: fTetWild seeds itself from the operating system.

    Parameters
    ----------
    vertices : (n, 3) float64
    faces : (m, 3) int32
        Pointing outwards; an inside-out surface comes back as a dozen vertices, without an error.
    edge_length, envelope : float
        Relative to the bounding-box diagonal.
    optimize : bool
        Improve the tetrahedra inside.
    timeout : float
        Seconds that it may work.

    Returns
    -------
    nodes : (p, 3) float64
    tetrahedra : (q, 4) int32

    Raises
    ------
    RemeshError
        If it overran, died, failed, or gave nothing.

    References
    ----------
    .. [1] Hu, Schneider, Wang, Zorin and Panozzo, "Fast tetrahedral meshing in the wild", ACM TOG 2020.
    """
    answer = _server.ask(
        {
            "vertices": vertices,
            "faces": faces,
            "edge_length": np.array(edge_length),
            "envelope": np.array(envelope),
            "optimize": np.array(optimize),
            "timeout": np.array(timeout),
        }
    )
    if "error" in answer:
        raise RemeshError(f"fTetWild failed: {answer['error']}")
    if not len(answer["tetrahedra"]):
        raise RemeshError("fTetWild gave no tetrahedra")
    return answer["nodes"], answer["tetrahedra"]


def start() -> None:
    """Start the server ahead of its first surface, so that its import overlaps other work."""
    _server.process()


class _Server:
    """The client's end of the one server process."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._lock = threading.Lock()
        atexit.register(self.stop)

    def process(self) -> subprocess.Popen[bytes]:
        """The running server; a new one where there is none."""
        if self._process is not None and self._process.poll() is None:
            return self._process
        self.stop()
        places = [str(Path(place).resolve()) for place in sys.path]
        self._process = subprocess.Popen(
            [sys.executable, "-c", SERVER, *places],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        return self._process

    def stop(self) -> None:
        """Kill the server, if any."""
        if self._process is not None:
            self._process.kill()
            for pipe in (self._process.stdin, self._process.stdout):
                if pipe is not None:
                    # What is still buffered for a dead process cannot be written any more.
                    with contextlib.suppress(OSError):
                        pipe.close()
            self._process.wait()
            self._process = None

    def ask(self, question: Arrays) -> Arrays:
        """The server's answer; `RemeshError` where it dies over it."""
        with self._lock:
            process = self.process()
            try:
                _send(process.stdin, question)
                return _receive(process.stdout)
            except (EOFError, OSError) as error:
                self.stop()
                if process.returncode == -signal.SIGALRM:
                    raise RemeshError(
                        f"fTetWild did not finish within {question['timeout']:g} s and was stopped"
                    ) from error
                raise RemeshError(f"fTetWild died, with exit code {process.returncode}") from error


_server = _Server()


def _send(pipe: IO[bytes] | None, arrays: Arrays) -> None:
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    if pipe is None:
        raise EOFError
    pipe.write(LENGTH.pack(buffer.tell()) + buffer.getvalue())
    pipe.flush()


def _receive(pipe: IO[bytes] | None) -> Arrays:
    head = pipe.read(LENGTH.size) if pipe is not None else b""
    if pipe is None or len(head) < LENGTH.size:
        raise EOFError
    (length,) = LENGTH.unpack(head)
    body = pipe.read(length)
    if len(body) < length:
        raise EOFError
    with np.load(io.BytesIO(body), allow_pickle=False) as archive:
        return dict(archive)


def _answer(question: Arrays) -> Arrays:
    import pytetwild

    # The alarm ends this process whoever holds the interpreter lock, and though its client be dead.
    signal.setitimer(signal.ITIMER_REAL, float(question["timeout"]))
    try:
        nodes, tetrahedra = pytetwild.tetrahedralize(  # type: ignore[attr-defined]
            question["vertices"],
            question["faces"],
            edge_length_fac=float(question["edge_length"]),
            epsilon=float(question["envelope"]),
            optimize=bool(question["optimize"]),
            num_threads=1,
        )
    except (RuntimeError, ValueError, TypeError) as error:
        return {"error": np.array(str(error))}
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
    return {"nodes": nodes.astype(np.float64), "tetrahedra": tetrahedra.astype(np.int32)}


def serve() -> None:
    """Answer surface after surface, from standard input to standard output, until the client has gone."""
    # The terminal sends Ctrl-C to the server too; its client decides what that means. Blocked rather than
    # ignored, because fTetWild sets signals back to their defaults.
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    _end_with_client()
    # fTetWild prints from C++: keep that from the messages and from the user. Python's errors still come.
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    sys.stderr = os.fdopen(os.dup(sys.stderr.fileno()), "w")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(nowhere, stream)
    import pytetwild  # noqa: F401  while the client still prepares its first surface

    # It also writes files where it runs; in a folder that is gone it cannot.
    folder = Path(tempfile.mkdtemp(prefix="pcretrieve-"))
    os.chdir(folder)
    folder.rmdir()
    with contextlib.suppress(EOFError, BrokenPipeError):
        while True:
            _send(answers, _answer(_receive(sys.stdin.buffer)))


def _end_with_client() -> None:
    """Have the kernel kill this process when its client dies, even in the middle of a surface.

    A client that overran its own limit is killed, and could not stop its server. Linux only; elsewhere the
    server goes on to the end of its surface.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
