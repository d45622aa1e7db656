"""The command `merge`: views in, one cloud out, and what became of each view."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapes
from benchmarks.samples import write_conf, write_pcd
from scipy.spatial.transform import Rotation

from pcretrieve import PointCloud, read_scan
from pcretrieve.points.register.alignment import moved
from pcretrieve.simulation import RigOptions, scan_views, write_ply

N_VIEWS = 6
RIG = RigOptions(n_views=N_VIEWS, pixels=120, n_points=None)


def run(*arguments: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "pcretrieve", "merge", *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        cwd=cwd,
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Views of a body before a scanner, a .conf that says where they belong, and a view of something else."""
    place = tmp_path_factory.mktemp("merge")
    rng = np.random.default_rng(0)
    body = scan_views(shapes.body(), RIG, rng)
    (place / "views").mkdir()
    names, motions = [], []
    for number, view in enumerate(body):
        assert view.viewpoints is not None
        away = np.eye(4)
        away[:3, :3], away[:3, 3] = Rotation.random(rng=rng).as_matrix(), rng.normal(0, 2, 3)
        names.append(f"view{number}.pcd")
        motions.append(np.linalg.inv(away))
        sensor = moved(away, view.viewpoints[:1])[0]
        write_pcd(place / "views" / names[-1], moved(away, view.points), sensor, Rotation.identity())
    write_conf(place / "body.conf", [f"views/{name}" for name in names], np.array(motions))
    torus = scan_views(shapes.torus(major=2.0), RIG, rng)[0]
    assert torus.viewpoints is not None
    write_pcd(place / "torus.pcd", torus.points, torus.viewpoints[0], Rotation.identity())
    write_ply(place / "ball.ply", shapes.points_on(shapes.icosphere(3), 500))
    write_ply(place / "few.ply", shapes.points_on(shapes.icosphere(3), 5))
    (place / "empty").mkdir()
    (place / "nowhere.conf").write_text("bmesh missing.ply 0 0 0 0 0 0 1\nbmesh ball.ply 0 0 0 0 0 0 1\n")
    (place / "no.conf").write_text("camera 0 0 0\n")
    return place


@pytest.fixture(scope="module")
def searched(folder: Path) -> tuple[subprocess.CompletedProcess[str], dict[str, Any]]:
    """All views of a folder and the foreign one, without poses."""
    (folder / "searched.ply").write_text("what stood there before")
    result = run("views", "torus.pcd", "-o", "searched.ply", "--json", cwd=folder)
    return result, json.loads(result.stdout)["result"]


def test_a_view_that_is_left_out_shows_in_words_in_json_and_in_the_exit_code(
    searched: tuple[subprocess.CompletedProcess[str], dict[str, Any]],
) -> None:
    result, answer = searched
    assert result.returncode == 3
    assert [view["placed"] for view in answer["views"]] == [True] * N_VIEWS + [False]
    assert answer["views"][-1]["pose"] is None and answer["views"][-1]["rms"] is None
    (line,) = [line for line in result.stderr.splitlines() if line.startswith("left out  ")]
    assert line.endswith("torus.pcd")
    assert any(note.startswith(f"left out view {N_VIEWS}") for note in answer["notes"])
    assert f"placed {N_VIEWS} of {N_VIEWS + 1} views" in result.stderr


@pytest.mark.parametrize("suffix", [".ply", ".pcd", ".xyzn"])
def test_the_poses_of_a_conf_are_kept_if_asked(suffix: str, folder: Path) -> None:
    result = run("body.conf", "--no-refine", "-o", f"kept{suffix}", cwd=folder)
    assert (result.returncode, result.stdout) == (0, "")
    kept, direct = read_scan(folder / f"kept{suffix}"), read_scan(folder / "body.conf")
    assert isinstance(kept, PointCloud) and isinstance(direct, PointCloud)
    assert kept.normals is not None and direct.viewpoints is not None
    np.testing.assert_allclose(kept.points, direct.points, atol=1e-5)
    if suffix != ".xyzn":
        assert kept.viewpoints is not None
        np.testing.assert_allclose(kept.viewpoints, direct.viewpoints, atol=1e-4)


@pytest.mark.slow
def test_the_largest_range_reaches_the_merge(folder: Path) -> None:
    """Three quarters of the points lie within the third quartile of the distances from their sensors."""
    scan = read_scan(folder / "body.conf")
    assert isinstance(scan, PointCloud) and scan.viewpoints is not None
    reach = np.quantile(np.linalg.norm(scan.points - scan.viewpoints, axis=1), 0.75)
    result = run("body.conf", "-o", "near.ply", "--json", "--max-range", str(reach), cwd=folder)
    assert result.returncode == 0
    assert json.loads(result.stdout)["result"]["points"] == pytest.approx(0.75 * len(scan.points), rel=0.01)


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        ("-o out.ply", 2, "name at least two views"),
        ("ball.ply", 2, "--output"),
        ("ball.ply torus.pcd -o out.ply --sensor behind", 2, "'behind' is not one of"),
        ("ball.ply -o out.ply", 1, "at least two views, got 1"),
        ("ball.ply few.ply -o out.ply", 1, "view 1 must have more than 16"),
        ("ball.ply torus.pcd -o out.obj", 1, "must end in one of .ply .pcd .xyzn"),
        ("ball.ply torus.pcd -o nowhere/out.ply", 1, "there is no folder nowhere"),
        ("ball.ply torus.pcd -o empty.ply/", 1, "is a folder"),
        ("ball.ply torus.pcd -o ball.ply", 1, "is one of the files to be read"),
        ("ball.ply body.conf -o out.ply", 1, "names all views of its cloud, got 2 files"),
        ("nowhere.conf -o out.ply", 1, "missing.ply"),
        ("no.conf -o out.ply", 1, "no.conf: a .conf file must name its views"),
        ("empty -o out.ply", 1, "names no scans"),
        ("ball.ply torus.pcd -o out.ply --max-range 3", 1, "view 0 does not say where that is"),
    ],
)
def test_what_cannot_be_merged_says_why_and_leaves_nothing(
    arguments: str, code: int, words: str, folder: Path
) -> None:
    (folder / "empty.ply").mkdir(exist_ok=True)
    before = sorted(path.name for path in folder.iterdir())
    result = run(*arguments.split(), cwd=folder)
    assert result.returncode == code
    assert words in result.stderr and "Traceback" not in result.stderr
    assert sorted(path.name for path in folder.iterdir()) == before
