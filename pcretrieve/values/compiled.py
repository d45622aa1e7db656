"""Loops that numba compiles, and what makes a process fast. An import compiles, copies and sets nothing."""

from __future__ import annotations

import atexit
import ctypes
import os
import sys
from collections.abc import Callable
from functools import cache, cached_property, update_wrapper
from pathlib import Path
from typing import Any, Generic, ParamSpec, TypeVar

import numpy as np

P = ParamSpec("P")
R = TypeVar("R")

PACKAGE = Path(__file__).parents[1]


class Compiled(Generic[P, R]):
    """A function that numba compiles when it is first called, and keeps for later processes.

    py_func, targetoptions: as those of numba's own, which reads them to inline the function in others.
    """

    def __init__(self, function: Callable[P, R], **settings: Any) -> None:
        self.py_func = function
        self.targetoptions = settings
        update_wrapper(self, function)

    @cached_property
    def dispatcher(self) -> Any:
        """What numba makes of the function."""
        return _numba().njit(cache=True, **self.targetoptions)(self.py_func)

    @property
    def _numba_type_(self) -> Any:
        """By which numba compiles the calls of this function in others."""
        return self.dispatcher._numba_type_

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        """Call the compiled function."""
        result: R = self.dispatcher(*args, **kwargs)
        return result


def compiled(**settings: Any) -> Callable[[Callable[P, R]], Compiled[P, R]]:
    """Compile a function by `numba.njit` with some settings, when it is first called."""

    def made(function: Callable[P, R]) -> Compiled[P, R]:
        return Compiled(function, **settings)

    return made


def inner(**settings: Any) -> Callable[[Callable[P, R]], Compiled[P, R]]:
    """As `compiled`, of a function that only compiled ones call: an eighth of the time of compiling less."""
    return compiled(no_cpython_wrapper=True, no_cfunc_wrapper=True, **settings)


def inlined(**settings: Any) -> Callable[[Callable[P, R]], Compiled[P, R]]:
    """As `inner`, of a function that runs in the innermost loops of others, and is compiled as part of each.

    Otherwise LLVM optimises it once alone and again in its caller, which may take twice as long, and each
    call counts the references to its arrays.
    """
    return compiled(inline="always", **settings)


def tuned_process() -> None:
    """Make this process faster. Workers and commands call it; a program that uses the library may."""
    # An untouched block, freed at once: glibc then keeps up to 64 MiB of free memory at the end of the heap,
    # twice the largest block that it has mapped and freed (mallopt(3), M_MMAP_THRESHOLD). Otherwise each
    # surface takes it again from the system, with thousands of page faults: 6 % of the time of a scan.
    np.empty((32 << 20) - (64 << 10), dtype=np.uint8)


# <sys/prctl.h> and <signal.h> of Linux.
PR_SET_PDEATHSIG = 1
SIGKILL = 9


def end_with_parent() -> None:
    """Ask the kernel to kill this process when its parent ends, also during a computation.

    Linux only: on other systems the process continues until it has finished, or next reads from or writes to
    a pipe. For the kernel, the parent is the thread that started this process.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, SIGKILL)


@cache
def _numba() -> Any:
    """The module numba, set up, which takes half a second to load."""
    import numba

    config: Any = numba.config
    # Rows of eight numbers are vectors of the processor, if numba lets LLVM combine equal operations. The
    # setting is one of the process; operations are combined, not reordered, so that no result changes.
    config.SLP_VECTORIZE = 1
    if not os.access(PACKAGE, os.W_OK):
        try:
            home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
            _lend_compiled(config.CACHE_DIR or Path(home, "numba"))
        except (OSError, RuntimeError):  # a home that cannot be written, or none
            from tempfile import TemporaryDirectory

            folder = TemporaryDirectory(prefix="pcretrieve-", ignore_cleanup_errors=True)
            atexit.register(folder.cleanup)
            # The variable is for child processes.
            os.environ["NUMBA_CACHE_DIR"] = config.CACHE_DIR = folder.name
            _lend_compiled(folder.name)
    return numba


def _lend_compiled(cache: str | Path) -> None:
    """Copy what setup.py has compiled to a cache of numba, which reads none that it cannot write."""
    from hashlib import sha1
    from shutil import copyfile

    for file in sorted(PACKAGE.rglob("__pycache__/*.nb[ci]")):
        room = file.parents[1]
        copy = Path(
            cache, f"{room.name}_{sha1(str(room).encode()).hexdigest()}", file.name
        )
        copy.parent.mkdir(parents=True, exist_ok=True)
        if not copy.exists() or copy.stat().st_mtime < file.stat().st_mtime:
            part = copy.with_suffix(f".{os.getpid()}")  # no other process sees half of it
            copyfile(file, part)
            part.replace(copy)
