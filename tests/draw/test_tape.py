"""Height and girths of simulated people whose bones, and therefore whose girths, are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapes
from benchmarks.simulation import POSES, RigOptions, body, make_subject
from benchmarks.simulation.bodies import skin
from benchmarks.simulation.scanner import scan
from benchmarks.simulation.skeleton import Subject
from commands import result, run
from scipy.spatial import ConvexHull

import pcretrieve as pr
from pcretrieve.catalogue import Content, Record
from pcretrieve.draw.axes import CHEST, HIP, WAIST, tape_measures
from pcretrieve.values import UNIT, Step

# Parts of the names of bones of arms.
OF_ARMS = ("arm", "hand", "finger", "thumb")

# Largest differences, m. ISO 20685 allows .004 for heights and .009 for large girths. Where the direction
# upwards is found from the body, within some degrees, they are worse.
ALLOWED = {"height": 0.03, "waist": 0.009, "hip": 0.015, "chest": 0.015}
UPRIGHT = {"height": 0.008, "waist": 0.009, "hip": 0.009, "chest": 0.009}
UP = np.array([0.0, 1.0, 0.0])


def standing(seed: int) -> tuple[Subject, pr.TriangleMesh]:
    chance = np.random.default_rng(seed)
    subject = make_subject("person", chance)
    return subject, body(subject, POSES["person"]["stand"], chance)


def known(subject: Subject, mesh: pr.TriangleMesh) -> dict[str, float]:
    """Girths of exact sections of the body, upright along y, without the skin of the bones of its arms."""
    own = skin(subject)
    names = [bone.name for bone in subject.bones]
    arms = np.array([any(part in name for part in OF_ARMS) for name in names])[own.owner]
    faces = mesh.faces[~arms[mesh.faces].any(axis=1)]
    sides = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    along = mesh.vertices[:, 1] - mesh.vertices[:, 1].min()
    height = float(along.max())

    def girth(level: float) -> float:
        above = along[sides] - level * height
        cut = (above > 0).sum(axis=1) == 1
        share = (above[cut, 0] / (above[cut, 0] - above[cut, 1]))[:, None]
        first, second = (mesh.vertices[sides[cut, end]] for end in (0, 1))
        return float(ConvexHull((first + share * (second - first))[:, [0, 2]]).area)

    return {
        "height": height,
        "chest": girth(CHEST),
        "waist": min(map(girth, WAIST)),
        "hip": max(map(girth, HIP)),
    }


@pytest.mark.parametrize("seed", range(4))
def test_girths_of_a_scan_are_those_of_the_body(seed: int) -> None:
    subject, mesh = standing(seed)
    expected = known(subject, mesh)
    scanned = pr.process(scan(mesh, RigOptions(), np.random.default_rng(seed)))
    meshes = [one.mesh for one in scanned.surfaces if one.mesh is not None]
    assert len(meshes) == 2
    for each in (mesh, *meshes):
        for up, limits in ((None, ALLOWED), (UP, UPRIGHT)):
            found = tape_measures(each.vertices, each.faces, up)
            assert 0.3 < found["thigh"] / found["hip"] < 0.6
            for name, allowed in limits.items():
                assert abs(found[name] - expected[name]) < allowed, (name, found)


def test_other_poses_and_bodies_have_none() -> None:
    chance = np.random.default_rng(1)
    subject = make_subject("person", chance)
    for pose in ("sit", "walk", "hands_on_hips"):
        mesh = body(subject, POSES["person"][pose], chance)
        assert tape_measures(mesh.vertices, mesh.faces) == {}, pose
    egg = shapes.ellipsoid((1, 0.6, 0.5), 3)
    assert tape_measures(egg.vertices, egg.faces) == {}


def test_measures_are_those_of_scans_with_a_unit(tmp_path: Path) -> None:
    _, mesh = standing(1)
    shape = pr.process(mesh, {"surface": {"mode": "keep"}})
    values = pr.describe(shape, pr.PipelineOptions().signature).values
    path = tmp_path / "c.sqlite"
    with pr.Catalogue(path, create=True) as store:
        for name, unit in (("known", 1.0), ("smaller", 0.98), ("unknown", None)):
            steps = (Step("read", 0.1, {} if unit is None else {UNIT: unit}),)
            record = Record(name, f"/{name}.ply", name, steps=steps)
            store.put(record, Content(shape, values))
        by_body = pr.stored_measures(store, "known")
        store.rows.keep_up("y")
        found = pr.stored_measures(store, "known")
        assert pr.stored_measures(store, "unknown") == {}
        assert pr.compare_measures(store, "known", "unknown") == {}
        height = pr.compare_measures(store, "known", "smaller")["height"]
    assert found["height"][0] == pytest.approx(np.ptp(mesh.vertices[:, 1]))
    assert by_body["height"][0] != pytest.approx(found["height"][0], abs=1e-4)
    assert height.second[0] == pytest.approx(0.98 * height.first[0])
    assert height.difference == pytest.approx(-0.02 * height.first[0])
    assert height.allowed == 0.004
    assert {*found} == {"height", "chest", "waist", "hip", "thigh", "volume"}
    volume, spread = found["volume"]
    assert volume == pytest.approx(mesh.volume) and spread == 0
    # One surface differs from none; two standing poses of one person differ.
    assert found["waist"][1] == 0.002 and found["height"][1] == 0.009
    shown = result("show", "known", "-c", path)["measures"]
    assert shown["waist"] == list(found["waist"])
    assert (
        f"waist {found['waist'][0]:.3f} ± 0.002"
        in run("show", "known", "-c", path).stdout
    )
    header, first, _, third = run(
        "list", "-c", path, "--csv", "--measures"
    ).stdout.splitlines()
    assert header.endswith("thigh,thigh ±,volume,volume ±")
    assert first.count(",") == header.count(",") and "m³" not in third
    asked = ("show", "known", "-c", path, "--versus")
    assert result(*asked, "smaller")["height"]["difference"] == height.difference
    lines = run(*asked, "smaller").stdout.splitlines()
    assert "ISO 20685 ALLOWS" in lines[0]
    assert lines[1].split()[:2] == ["height", f"{height.first[0]:.3f}"]
    assert "stand with hanging arms" in run(*asked, "unknown").stderr
