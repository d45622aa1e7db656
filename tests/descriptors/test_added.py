"""Descriptors of other packages: what their records declare is what they are given, and must give."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapes
from packages import install

from pcretrieve.descriptors import Descriptor, describe
from pcretrieve.errors import OptionError, ShapeError
from pcretrieve.options import PipelineOptions, SignatureOptions
from pcretrieve.pipeline.process import process
from pcretrieve.spectral import unit_eigenpairs
from pcretrieve.values import PointCloud, Shape, Signature, Surface

MODULE = '''
import numpy as np

from pcretrieve.descriptors import Descriptor
from pcretrieve.values import Signature


def three(options):
    return 3


def lowest(shape, options):
    """Any numbers, of the mesh."""
    return Signature(shape.mesh.vertices.min(axis=0), kind="lowest", metric="values")


def extent(shape, options):
    """Positive numbers, of the mesh."""
    return Signature(np.ptp(shape.mesh.vertices, axis=0)[: options.n_values], kind="extent")


def center(shape, options):
    return Signature(shape.points.points.mean(axis=0), kind="center", metric="values")


def waves(shape, options):
    pairs = shape.eigenpairs
    return Signature([*pairs.eigenvectors.shape, pairs.area], kind="waves")


def hollow(shape, options):
    return Signature(np.zeros(3), kind="hollow")


LOWEST = Descriptor("lowest", lowest, needs=("mesh",), length=three, metric="values")
CENTER = Descriptor("center", center, needs=("points",), length=three, metric="values")
WAVES = Descriptor("waves", waves, needs=("eigenvectors",), length=three)
HOLLOW = Descriptor("hollow", hollow, needs=("spectrum",), length=three)
SLY = Descriptor("sly", lowest, needs=("spectrum",), length=three, metric="values")
SHORT = Descriptor("short", extent, needs=("mesh",), length=lambda options: options.n_values + 1)
MOODY = Descriptor("moody", lowest, needs=("mesh",), length=three)
'''
RECORDS = ("lowest", "center", "waves", "hollow", "sly", "short", "moody")
ENTRY_POINTS = "[pcretrieve.descriptors]\nextent = theirs:extent\n"
ENTRY_POINTS += "".join(f"{name} = theirs:{name.upper()}\n" for name in RECORDS)


@pytest.fixture(autouse=True)
def _installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path / "site", "theirs", {"theirs": MODULE}, ENTRY_POINTS, monkeypatch)


@cache
def both() -> Shape:
    """A scan that was made into two surfaces, with its points."""
    meshes = shapes.body(3), shapes.ellipsoid((1, 1, 1.4), subdivisions=3)
    surfaces = (process(mesh, PipelineOptions()).surfaces[0] for mesh in meshes)
    return Shape(tuple(surfaces), PointCloud(meshes[0].vertices - 3))


def options(method: str, **changed: Any) -> SignatureOptions:
    return SignatureOptions(method=method, n_values=3, **changed)


def test_what_a_descriptor_is_given() -> None:
    first = both().apart()[0]
    extent = describe(first, options("extent"))  # a function is a descriptor too
    np.testing.assert_array_equal(extent.values, np.ptp(first.mesh.vertices, axis=0))
    assert len(describe(both(), options("lowest")).values) == 3
    # The points of a scan are described once.
    center = describe(both(), options("center"))
    assert center.errors is None
    np.testing.assert_allclose(center.values, both().points.points.mean(axis=0))
    # Eigenvectors come from the shape or from its mesh.
    kept = Shape((Surface(1.0, eigenpairs=unit_eigenpairs(first.mesh, 31)),))
    for shape in (first, kept):
        waves = describe(shape, options("waves", n_modes=20))
        assert waves.values.tolist() == [642, 21, pytest.approx(1)]


@pytest.mark.parametrize(
    ("method", "message"),
    [
        (
            "sly",
            "gone: the shape must hold its mesh, but does not: not kept .* or not among the needs",
        ),
        (
            "short",
            "the descriptor 'short' of the package theirs must give 4 values, as its record .* got 3",
        ),
        ("moody", "must give a Signature with the metric 'logarithms', got Signature"),
        ("hollow", "failed, InputError: signature values must be positive, got 0.0"),
        ("center", r"\[signature\] gone: the shape must hold its points, but does not"),
        ("waves", "gone: the shape must hold its mesh"),
    ],
)
def test_what_a_descriptor_may_not_do_fails_its_shape(method: str, message: str) -> None:
    bare = Shape((Surface(1.0, both().spectrum),))
    with pytest.raises(ShapeError, match=message) as raised:
        describe(bare if method in ("center", "waves") else both(), options(method))
    assert raised.value.stage == "signature"


def test_records_that_declare_what_does_not_exist() -> None:
    for declared, message in (
        (
            {"needs": ("voxels",)},
            "needs of a descriptor must be of spectrum, .* points, got 'voxels'",
        ),
        (
            {"needs": (), "metric": "angles"},
            "metric of a descriptor must be of logarithms, .* got 'angles'",
        ),
    ):
        with pytest.raises(OptionError, match=message):
            Descriptor(
                "x", lambda shape, options: Signature(np.ones(1), kind="x"), **declared
            )
