"""The side of a worker process: items in, answers out, as pickles behind their lengths."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import pickle
import struct
import sys
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TypeVar

from pcretrieve.errors import shape_error
from pcretrieve.ingestion.temporary import use_folder
from pcretrieve.surface.tetwild import end_with_parent

__all__ = ["LENGTH", "serve"]

Item = TypeVar("Item")
Answer = TypeVar("Answer")

# An answer is its length, followed by a pickle. The first answer only says that the worker is ready.
LENGTH = struct.Struct("<q")


def serve(
    tasks: Connection[Any, Any],
    answers: Connection[Any, Any],
    output: Connection[Any, Any],
    folder: str | None,
    function: Callable[[Item], Answer],
    prepare: Callable[[], object],
) -> None:
    """Answer tasks until the parent process ends: what a worker process does.

    Parameters
    ----------
    tasks, answers, output : Connection
        Ends of the pipes: items are received, and answers and what is printed are sent.
    folder : str or None
        The folder for temporary files.
    function : callable
        A function of one item.
    prepare : callable
        A function that is called first.
    """
    for standard in (1, 2):
        os.dup2(output.fileno(), standard)
    output.close()
    end_with_parent()
    parent = multiprocessing.parent_process()
    if parent is None or os.getppid() != parent.pid:
        return  # the parent has ended before `end_with_parent`
    end_instead_of_parent()
    use_folder(folder)
    prepare()
    own = os.getpid()
    with suppress(EOFError, BrokenPipeError):  # the parent has ended, on a system without `end_with_parent`
        _send(answers, pickle.dumps(True))
        while True:
            answer = _answer(function, tasks.recv())
            if os.getpid() != own:
                # A child process that the function has forked, and in which the function returned too: its
                # answer would be taken for that of the next item.
                os._exit(1)
            _send(answers, answer)


def _answer(function: Callable[[Item], Answer], item: Item) -> bytes:
    """What the function returned or raised, pickled. A plug-in may raise anything, also SystemExit."""
    try:
        return pickle.dumps(function(item))
    except BaseException as error:  # noqa: BLE001
        return pickle.dumps(shape_error(error))
    finally:
        _flush()


def _flush() -> None:
    """Send what Python and C libraries have printed, and hold in memory."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(Exception):  # a plug-in may have closed or replaced it
            stream.flush()
    ctypes.CDLL(None).fflush(None)


def _send(answers: Connection[Any, Any], message: bytes) -> None:
    rest = memoryview(LENGTH.pack(len(message)) + message)
    while rest:
        rest = rest[os.write(answers.fileno(), rest) :]


# What the kernel adds to the memory of a process before it compares processes; thousandths of all memory.
OOM_SCORE = 500


def end_instead_of_parent() -> None:
    """Ask the kernel to kill this process rather than its parent when the computer lacks memory.

    Linux only: other systems, and a Linux without ``/proc``, choose as they do.
    """
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(f"{OOM_SCORE}\n", encoding="ascii")
