"""Readers of other packages, which an entry point adds."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import shapes
from scan_files import CUBE, cloud

from pcretrieve import PointCloud, read_scan
from pcretrieve.errors import InputError, ScanReadError
from pcretrieve.formats import ScanPath, write_cloud, write_mesh
from pcretrieve.formats.identity import content_hash
from pcretrieve.ingestion.discover import discover


@pytest.fixture
def plugin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of an installed package that reads .grid files."""
    site = tmp_path / "site"
    (site / "gridscan-1.0.dist-info").mkdir(parents=True)
    (site / "gridscan-1.0.dist-info" / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: gridscan\nVersion: 1.0\n"
    )
    (site / "gridscan-1.0.dist-info" / "entry_points.txt").write_text(
        "[pcretrieve.readers]\n.grid = gridscan:read_grid\n"
    )
    monkeypatch.syspath_prepend(site)
    monkeypatch.delitem(sys.modules, "gridscan", raising=False)
    return site


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (
            "import a_module_that_is_nowhere",
            "cannot be loaded, ModuleNotFoundError: No module named",
        ),
        ("raise SystemExit(0)", "cannot be loaded, SystemExit: 0;"),
        (
            "read_mesh = None",
            "cannot be loaded, AttributeError: module 'gridscan' has no attribute",
        ),
        (
            "read_grid = None",
            "must be a Format, or a function that reads a file, got NoneType;",
        ),
        (
            "def read_grid(path): return [1, 2]",
            "failed, TypeError: a reader must return a RawScan, got list",
        ),
        ("def read_grid(path): raise SystemExit(0)", "failed, SystemExit: 0"),
        (
            "def read_grid(path): return path.suffix / 2",
            "failed, TypeError: unsupported operand",
        ),
        (
            "def read_grid(path): return RawScan([1, 2])",
            "points must have the shape (n, 3), got (2,)",
        ),
        (
            "def read_grid(path): return RawScan([[1, 2, 3]], normals=[[0, 0, 1]] * 2)",
            "normals must have the shape (1, 3), got (2, 3)",
        ),
        (
            "def read_grid(path): return RawScan([[1, 2, 3]], faces=[[0, 0, 0.5]])",
            "faces must be whole numbers",
        ),
        (
            "def read_grid(path): return RawScan([[1, 2, 3]], unit='ell')",
            "the unit must be one of um, mm",
        ),
    ],
)
def test_a_package_whose_reader_is_broken_fails_its_own_files_only(
    code: str, words: str, plugin: Path, tmp_path: Path
) -> None:
    (plugin / "gridscan.py").write_text(
        f"from pcretrieve.formats import RawScan\n{code}\n"
    )
    (tmp_path / "a.grid").write_text("1 2 3\n")
    (tmp_path / "b.xyz").write_text("1 2 3\n")
    with pytest.raises(ScanReadError) as raised:
        read_scan(tmp_path / "a.grid")
    assert "the format '.grid' of the package gridscan" in raised.value.message
    assert words in raised.value.message
    assert len(cloud(tmp_path / "b.xyz").points) == 1


TILES = """
import numpy as np
from pcretrieve.formats import Format, Part, RawScan

def parts(path):
    return tuple(Part(path.parent / name) for name in path.read_text().split())

def read(path):
    return RawScan(np.concatenate([np.loadtxt(part.path, ndmin=2) for part in parts(path)]))

def write(cloud):
    if len(cloud.points) > 2:
        raise RuntimeError("too many points")
    return "".join("%g %g %g\\n" % tuple(point) for point in cloud.points).encode()

read_grid = Format(read, parts, write_cloud=write)
"""


def test_an_installed_package_brings_a_format_of_several_files(
    plugin: Path, tmp_path: Path
) -> None:
    (plugin / "gridscan.py").write_text(TILES)
    (tmp_path / "a.grid").write_text("left.xyz right.tile\n")
    write_cloud(PointCloud(CUBE[:2]), tmp_path / "left.grid")
    (tmp_path / "left.grid").rename(tmp_path / "left.xyz")
    (tmp_path / "right.tile").write_text("4 5 6\n")
    np.testing.assert_array_equal(
        cloud(tmp_path / "a.grid").points, [*CUBE[:2], [4, 5, 6]]
    )
    before = content_hash(ScanPath.parse(tmp_path / "a.grid"))
    (tmp_path / "right.tile").write_text("4 5 7\n")
    assert content_hash(ScanPath.parse(tmp_path / "a.grid")) != before
    assert discover([tmp_path]) == [ScanPath(tmp_path / "a.grid")]


def test_a_package_whose_writer_is_broken(plugin: Path, tmp_path: Path) -> None:
    (plugin / "gridscan.py").write_text(TILES)
    with pytest.raises(
        InputError, match="of the package gridscan failed, RuntimeError: too many points"
    ):
        write_cloud(PointCloud(CUBE), tmp_path / "a.grid")
    with pytest.raises(InputError, match=r"a mesh file must end in one of \.ply \.obj"):
        write_mesh(shapes.icosphere(0), tmp_path / "a.grid")
