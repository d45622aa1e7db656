"""Every bad scan in one batch: one message each, and nothing lost of the others."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import shapes
from commands import program

from pcretrieve.formats import write_mesh
from pcretrieve.values import FloatArray, TriangleMesh

pytestmark = pytest.mark.slow

GOOD = ("copy_of_good", "zwei-Körper-é", "inside_out", "some_nan")

# What the message of each must name.
REASONS = {
    "empty": ("read", "empty"),
    "truncated": ("read", "not a complete PLY file"),
    "huge": ("read", "not a complete PLY file"),
    "all_nan": ("read", "finite"),
    "plane": ("crop", "in a plane"),
    "ten": ("crop", "at least 100 points, got 10"),
    "one_triangle": ("", "plane"),
    "two_bodies": ("surface", "two bodies or more"),
    "mobius": ("surface", "one-sided"),
    "other_format": ("read", "not a"),
    "broken_link": ("read", "cannot read"),
}


def ply(points: FloatArray, count: int | None = None) -> bytes:
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points) if count is None else count}\n"
        "property float x\nproperty float y\nproperty float z\nend_header\n"
    )
    return header.encode() + points.astype("<f4").tobytes()


def write_scans(folder: Path) -> None:
    """The good and the bad ones, a file of labels and a manifest."""
    rng = np.random.default_rng(0)
    ball = shapes.icosphere(3)
    points = shapes.points_on(ball, 3000)
    write_mesh(ball, folder / "good.off")
    write_mesh(TriangleMesh(ball.vertices * [1, 1, 2], ball.faces), folder / "zwei-Körper-é.off")
    write_mesh(TriangleMesh(ball.vertices * [1, 2, 3], ball.faces[:, ::-1]), folder / "inside_out.off")
    holed = points.copy()
    holed[::100] = np.nan
    (folder / "some_nan.ply").write_bytes(ply(holed))
    (folder / "empty.ply").write_bytes(b"")
    (folder / "truncated.ply").write_bytes(ply(points)[:-7000])
    (folder / "huge.ply").write_bytes(ply(points, count=10**12))
    (folder / "all_nan.ply").write_bytes(ply(np.full((500, 3), np.inf)))
    (folder / "plane.ply").write_bytes(ply(rng.random((500, 3)) * [1, 1, 0]))
    np.savetxt(folder / "ten.xyz", points[:10])
    (folder / "one_triangle.off").write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    apart = shapes.moved(ball, 0)
    both = shapes.joined(ball, TriangleMesh(apart.vertices + 10, apart.faces))
    write_mesh(both, folder / "two_bodies.off")
    write_mesh(shapes.mobius_strip(), folder / "mobius.off")
    (folder / "other_format.ply").write_bytes((folder / "good.off").read_bytes())
    (folder / "broken_link.ply").symlink_to(folder / "nowhere.ply")
    (folder / "copy_of_good.off").write_bytes((folder / "good.off").read_bytes())
    names = "\n".join(["file,class", "copy_of_good,ball", "zwei-Körper-é.off,Ei", "unknown_shape,ball"])
    (folder / "labels.csv").write_text(names, encoding="utf-8")
    listed = sorted(path.name for path in folder.iterdir() if path.suffix != ".csv")
    (folder / "manifest.txt").write_text("\n".join(listed), encoding="utf-8")


def test_each_bad_one_says_why_and_the_good_ones_are_kept(tmp_path: Path) -> None:
    write_scans(tmp_path)
    words = ("ingest", "manifest.txt", "-c", "c.sqlite", "--labels", "labels.csv", "--json")
    done = program(*words, cwd=tmp_path, code=3)
    answer = json.loads(done.stdout)["result"]
    # Of two files with one content, the first in the order given is the shape.
    assert set(answer["done"]) == set(GOOD)
    assert [Path(duplicate["path"]).name for duplicate in answer["duplicates"]] == ["good.off"]
    assert answer["unknown_labels"] == ["unknown_shape"]
    failed = {failure["id"]: failure for failure in answer["failed"]}
    assert failed.keys() == REASONS.keys()
    for name, (stage, reason) in REASONS.items():
        assert stage in failed[name]["stage"], name
        assert reason in failed[name]["message"], name
        assert len([line for line in done.stderr.splitlines() if f"[{name} /" in line]) == 1, name
