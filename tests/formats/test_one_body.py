"""One body in forty files of twenty formats, by other libraries, has one signature."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
import shapes
from foreign_files import write_clouds, write_meshes
from laser_files import CAN_WRITE

import pcretrieve as pr
from pcretrieve import PointCloud, TriangleMesh, read_scan
from pcretrieve.formats import missing_extra
from pcretrieve.values import FloatArray

BODY = shapes.body(3)
POINTS = shapes.points_on(BODY, 6000)
# Largest error of coordinates of about 1, in text of six digits; and in LAS files of steps of 1e-4.
DIGITS, STEP = 6e-6, 6e-5
# Relative difference of the values of signatures of one surface: the order of sums, and single precision.
SURFACE_TOLERANCE = 1e-4
# The same of points, of which the reconstruction may put single cells to another side.
POINTS_TOLERANCE = 0.02

EVERYTHING = all(CAN_WRITE.values()) and not any(map(missing_extra, (".3mf", ".dae", ".e57", ".laz")))


@pytest.fixture(scope="module")
def meshes(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of the libraries that write
        return write_meshes(BODY, tmp_path_factory.mktemp("meshes"))


@pytest.fixture(scope="module")
def clouds(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        return write_clouds(POINTS, tmp_path_factory.mktemp("clouds"))


@pytest.mark.skipif(not EVERYTHING, reason="needs the extras meshes, las, e57 and laspy")
def test_there_are_forty_files_of_twenty_formats(meshes: list[Path], clouds: list[Path]) -> None:
    files = [*meshes, *clouds]
    assert len(files) >= 40
    assert len({file.suffix for file in files}) >= 20


def test_the_surface_of_every_file_has_one_signature(meshes: list[Path]) -> None:
    expected = pr.signature(BODY).values
    for file in meshes:
        found = read_scan(file)
        assert isinstance(found, TriangleMesh), file
        assert len(found.vertices) == len(BODY.vertices), file
        assert len(found.faces) == len(BODY.faces), file
        # trimesh writes 3MF files in millimetres, which are read in metres.
        volume = BODY.volume * (1e-9 if file.suffix == ".3mf" else 1)
        assert found.volume == pytest.approx(volume, rel=1e-5), file
        values = pr.signature(file).values
        np.testing.assert_allclose(values, expected, rtol=SURFACE_TOLERANCE, err_msg=str(file))


@pytest.mark.slow
def test_the_points_of_every_file_have_one_signature(clouds: list[Path]) -> None:
    """Most files give the same numbers: a signature is computed once for each array."""
    expected = pr.signature(PointCloud(POINTS)).values
    signatures: dict[bytes, FloatArray] = {}
    for file in clouds:
        found = read_scan(file)
        assert isinstance(found, PointCloud), file
        assert found.normals is None, file
        atol = STEP if file.suffix in (".las", ".laz") else DIGITS
        np.testing.assert_allclose(found.points, POINTS, atol=atol, err_msg=str(file))
        key = found.points.tobytes()
        if key not in signatures:
            signatures[key] = pr.signature(found).values
        np.testing.assert_allclose(signatures[key], expected, rtol=POINTS_TOLERANCE, err_msg=str(file))
    assert len(signatures) < len(clouds)
