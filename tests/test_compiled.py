"""Loops that numba compiles: what `compiled` adds to `numba.njit`."""

from typing import Any

import numba

from pcretrieve.descriptors.hapt import _windings
from pcretrieve.pipeline.process import compile_later_stages
from pcretrieve.spectral.blocks import substitute
from pcretrieve.surface.marching import _triangulated
from pcretrieve.values.compiled import compiled
from pcretrieve.values.simplify import _collapsed


@compiled(inline="always")
def _inner(x: int) -> int:
    return 2 * x


@compiled()
def _outer(n: int) -> int:
    total = 0
    for x in range(n):
        total += _inner(x)
    return total


def test_a_function_that_is_inlined_is_part_of_its_caller() -> None:
    # Not kept for later processes: numba does not show what it has read from a file.
    njit: Any = numba.njit
    caller = njit(_outer.py_func)
    assert caller(4) == 12
    (llvm,) = caller.inspect_llvm().values()
    assert "_inner" not in llvm


def test_the_second_process_makes_voxels_simplifies_solves_and_describes() -> None:
    """Its errors are shown nowhere, because the first process compiles what it has not."""
    compile_later_stages()
    for loop in (_triangulated, _collapsed, substitute, _windings):
        assert loop.dispatcher.signatures
