"""Commands on scans: `signature`, `reconstruct`, `inspect`, `report-problem`, `merge` and `demo`."""

from __future__ import annotations

import csv
import json
import shlex
import zipfile
from html import unescape
from pathlib import Path
from urllib.parse import unquote, urlparse

import numpy as np
import pytest
import shapes
from benchmarks.samples import write_conf, write_pcd
from benchmarks.simulation import RigOptions, scan_views, write_ply
from commands import program, refusal, result, run
from PIL import Image
from scipy.spatial.transform import Rotation

import pcretrieve as pr
from pcretrieve.cli import batches
from pcretrieve.formats import write_mesh
from pcretrieve.pipeline.registration.alignment import moved

LENGTHS = {"a": 1.5, "b": 2.0, "c": 3.0}
FEW_CELLS = "[surface]\ncell = 0.01\ntarget_faces = 3000\n"
RIG = RigOptions(n_views=6, pixels=120, n_points=None)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three eggs, of which the first takes longest, and a file that cannot be read."""
    place = tmp_path_factory.mktemp("scans") / "scans"
    (place / "more").mkdir(parents=True)
    for name, length in LENGTHS.items():
        egg = shapes.ellipsoid((1, 1, length), subdivisions=5 if name == "a" else 3)
        write_mesh(egg, place / ("more" if name == "c" else "") / f"{name}.off")
    (place / "bad.off").write_text("OFF\n")
    return place


# --- signature and reconstruct --------------------------------------------------------------------------


@pytest.mark.slow
def test_signatures_are_those_of_the_single_scans_in_their_order(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done = run("lab", "signature", folder, "--workers", 2, code=3)
    assert done.stderr.startswith("signature: 4 scans\n")
    assert "failed: [bad / read]" in done.stderr
    lines = [line.split("\t") for line in done.stdout.splitlines()]
    assert [Path(line[0]).stem for line in lines] == ["a", "b", "c"]
    path, *values = lines[1]
    monkeypatch.setattr("pcretrieve.cli.messages.LINE_INTERVAL", 0.0)
    alone = run("lab", "signature", path)
    assert (alone.stdout.strip().split("\t")[1:], alone.stderr) == (values, "")
    # From a catalogue they are those of what it stores, also if the files are gone.
    catalogue, *files = (
        tmp_path / "c.sqlite",
        *(tmp_path / name for name in ("b.off", "bad.off")),
    )
    for file in files:
        file.write_bytes((folder / file.name).read_bytes())
    run("ingest", *files, "-c", catalogue, "--workers", 1, "--quiet", code=3)
    for file in files:
        file.unlink()
    stored = run(
        "lab",
        "signature",
        "--from-catalogue",
        catalogue,
        "bad",
        "b",
        "--method",
        "wks",
        code=3,
    )
    assert stored.stderr.startswith("failed: [bad / read] ")
    name, *numbers = stored.stdout.strip().split("\t")
    direct = (
        run("lab", "signature", folder / "b.off", "--method", "wks")
        .stdout.strip()
        .split("\t")[1:]
    )
    assert name == "b"
    np.testing.assert_allclose([*map(float, numbers)], [*map(float, direct)], rtol=1e-6)
    found = result("lab", "signature", "--from-catalogue", catalogue, "bad", "b", code=3)
    assert [("error" in row, row["id"]) for row in found] == [(True, "bad"), (False, "b")]


def test_each_scan_of_a_folder_is_reconstructed(folder: Path, tmp_path: Path) -> None:
    done = run(
        "reconstruct",
        folder,
        "-o",
        tmp_path / "meshes",
        "--suffix",
        ".obj",
        "--json",
        code=3,
    )
    assert {path.name for path in (tmp_path / "meshes").iterdir()} == {
        "a.obj",
        "b.obj",
        "c.obj",
    }
    by_name = {
        Path(found["path"]).stem: found for found in json.loads(done.stdout)["result"]
    }
    assert by_name["bad"]["error"] == "ScanReadError"
    for name, length in LENGTHS.items():
        mesh = pr.read_scan(tmp_path / "meshes" / f"{name}.obj")
        assert isinstance(mesh, pr.TriangleMesh)
        assert np.ptp(mesh.vertices, axis=0)[2] == pytest.approx(2 * length, rel=0.01)
        assert by_name[name]["faces"] == len(mesh.faces)
    assert f"3 surfaces are in {tmp_path / 'meshes'}, 1 scans failed" in done.stderr


# --- inspect and report-problem -------------------------------------------------------------------------


@pytest.mark.slow
def test_an_inspection_has_checks_numbers_and_pictures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_ply(Path("body.ply"), shapes.points_on(shapes.body(), 8000))
    Path("fast.toml").write_text(FEW_CELLS)
    asked = (
        "body.ply",
        "-o",
        "page.html",
        "--png",
        "sheet.png",
        "--config",
        "fast.toml",
        "--rescans",
        2,
    )
    done = run("inspect", *asked, "--json")
    answer = json.loads(done.stdout)["result"]
    assert answer["page"] == str(tmp_path / "page.html")
    assert answer["failure"] is None
    assert answer["grade"]["error"] >= answer["rescan_error"]
    assert {"Points", "Normals", "Handles", "Signature"} <= {
        check["name"] for check in answer["checks"]
    }
    for check in answer["checks"]:
        assert f"{check['outcome']:<6}  {check['name']}" in done.stderr
    assert len(answer["signature"]) == len(answer["rescan_errors"]) == 23
    assert "errors" not in answer, "that is over the surfaces of one scan"
    assert [step["stage"] for step in answer["steps"]][:3] == ["read", "crop", "clean"]
    with Image.open("sheet.png") as sheet:
        assert sheet.format == "PNG" and sheet.width > 1000


def test_a_scan_that_fails_gets_its_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_ply(Path("few.ply"), shapes.points_on(shapes.body(), 50))
    Path("garbage.ply").write_bytes(b"\x00\xff" * 500)
    for scan, stage in (("garbage.ply", "read"), ("few.ply", "crop")):
        done = run("inspect", scan, "--png", "sheet.png", "--json", code=3)
        answer = json.loads(done.stdout)["result"]
        assert answer["failure"]["stage"] == stage
        assert (
            answer["signature"]
            is answer["rescan_errors"]
            is answer["rescan_error"]
            is None
        )
        page = unescape(Path(answer["page"]).read_text(encoding="utf-8"))
        assert f"the {stage} stage failed" in page
        assert answer["failure"]["message"].replace(f"{tmp_path}/", "") in page
        assert f"the {stage} stage failed" in done.stderr
        assert ("<canvas" in page) == ("<img" in page) == (stage != "read")
        with Image.open("sheet.png") as sheet:
            assert np.asarray(sheet).min() < 100  # something is drawn


def packed(path: str) -> dict[str, str]:
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name).decode() for name in archive.namelist()}


def test_a_scan_that_fails_is_packed_without_its_points_and_its_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    private = tmp_path / "Jane Doe"
    private.mkdir()
    monkeypatch.chdir(tmp_path)
    scan = private / "sheet.xyz"
    scan.write_text("".join(f"{i % 9} {i // 9} 0\n" for i in range(8)))
    done = run("lab", "report-problem", scan, "--unit", "cm")
    assert done.stdout == "sheet-problem.zip\n"
    files = packed("sheet-problem.zip")
    assert sorted(files) == ["log.txt", "options.toml", "problem.json"]
    found = json.loads(files["problem.json"])
    assert found["versions"]["pcretrieve"] == pr.__version__
    assert found["scan"]["name"] == "sheet.xyz"
    assert found["scan"]["bytes"] == scan.stat().st_size
    assert (
        f"failed in {found['failure']['stage']}: {found['failure']['message']}"
        in done.stderr
    )
    assert "Jane Doe" not in "".join(files.values())
    Path("options.toml").write_text(files["options.toml"])
    assert pr.PipelineOptions.from_toml("options.toml").scan.unit == "cm"
    run("lab", "report-problem", scan, "--with-scan", "-o", "p.zip")
    assert packed("p.zip")["scan/sheet.xyz"] == scan.read_text()
    # Where the process is ended and nothing measured, there are the versions, the options and the error.
    write_mesh(shapes.icosphere(6), private / "ball.off")
    run(
        "lab",
        "report-problem",
        private / "ball.off",
        "--timeout",
        1,
        "--surface",
        "reconstruct",
    )
    assert (
        json.loads(packed("ball-problem.zip")["problem.json"])["failure"]["error"]
        == "StageTimeout"
    )


def test_a_scan_with_a_missing_view_is_packed_as_far_as_it_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_mesh(shapes.icosphere(1), tmp_path / "there.ply")
    pose = "0 0 0 0 0 0 1"
    Path("all.conf").write_text(f"bmesh there.ply {pose}\nbmesh lost.ply {pose}\n")
    done = run("lab", "report-problem", "all.conf", "--with-scan")
    assert "missing, and not in the file: lost.ply" in done.stderr
    assert "failed in read: " in done.stderr
    with zipfile.ZipFile("all-problem.zip") as archive:
        assert {"scan/all.conf", "scan/there.ply"} < {*archive.namelist()}
        scan = json.loads(archive.read("problem.json"))["scan"]
    assert (scan["missing"], scan["content_hash"]) == (["lost.ply"], None)
    assert "cannot read" in refusal("lab", "report-problem", "nowhere.conf")


# --- merge ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def views(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two views of a body before a scanner, a .conf with their places, and a view of something else."""
    place = tmp_path_factory.mktemp("merge")
    rng = np.random.default_rng(0)
    (place / "views").mkdir()
    names, motions = [], []
    for number, view in enumerate(scan_views(shapes.body(), RIG, rng)[2:4]):
        assert view.viewpoints is not None
        away = np.eye(4)
        away[:3, :3], away[:3, 3] = (
            Rotation.random(rng=rng).as_matrix(),
            rng.normal(0, 2, 3),
        )
        names.append(f"views/view{number}.pcd")
        motions.append(np.linalg.inv(away))
        sensor = moved(away, view.viewpoints[:1])[0]
        write_pcd(
            place / names[-1], moved(away, view.points), sensor, Rotation.identity()
        )
    write_conf(place / "body.conf", names, np.array(motions))
    torus = scan_views(shapes.torus(major=2.0), RIG, rng)[0]
    assert torus.viewpoints is not None
    write_pcd(place / "torus.pcd", torus.points, torus.viewpoints[0], Rotation.identity())
    return place


def test_a_view_that_is_left_out_shows_in_words_in_json_and_in_the_exit_code(
    views: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(views)
    (views / "searched.ply").write_text("what stood there before")
    done = run("merge", "views", "torus.pcd", "-o", "searched.ply", "--json", code=3)
    answer = json.loads(done.stdout)["result"]
    assert [view["placed"] for view in answer["views"]] == [True, True, False]
    assert answer["views"][-1]["pose"] is None and answer["views"][-1]["rms"] is None
    (line,) = [line for line in done.stderr.splitlines() if line.startswith("left out  ")]
    assert line.endswith("torus.pcd")
    assert any(note.startswith("left out view 2") for note in answer["notes"])
    assert "placed 2 of 3 views" in done.stderr


def test_the_poses_of_a_conf_and_the_largest_range_are_kept(
    views: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three quarters of the points lie within the third quartile of the distances from their sensors."""
    monkeypatch.chdir(views)
    direct = pr.read_scan("body.conf")
    assert isinstance(direct, pr.PointCloud) and direct.viewpoints is not None
    for suffix in (".ply", ".pcd", ".xyzn"):
        assert (
            run("merge", "body.conf", "--no-refine", "-o", f"kept{suffix}").stdout == ""
        )
        kept = pr.read_scan(f"kept{suffix}")
        assert isinstance(kept, pr.PointCloud) and kept.normals is not None
        np.testing.assert_allclose(kept.points, direct.points, atol=1e-5)
        if suffix != ".xyzn":
            assert kept.viewpoints is not None
            np.testing.assert_allclose(kept.viewpoints, direct.viewpoints, atol=1e-4)
    reach = np.quantile(np.linalg.norm(direct.points - direct.viewpoints, axis=1), 0.75)
    Path("near.toml").write_text(f"[scan]\nmax_range = {reach}\n")
    for given in (("--max-range", reach), ("--config", "near.toml")):
        found = result("merge", "body.conf", "--no-refine", "-o", "near.ply", *given)
        assert found["points"] == pytest.approx(0.75 * len(direct.points), rel=0.01)


# --- demo -----------------------------------------------------------------------------------------------


def test_the_demo_has_a_class_for_each_scan_that_it_ingests() -> None:
    shipped = Path(batches.__file__).parent / "demo"
    with (shipped / "scans" / "labels.csv").open(newline="", encoding="utf-8") as file:
        labels = {row["file"]: row["class"] for row in csv.DictReader(file)}
    scans = {
        path.relative_to(shipped / "scans") for path in shipped.glob("scans/*/*.ply")
    }
    assert scans == {Path(name) for name in labels}
    assert (shipped / batches.DEMO_QUERY).is_file()
    assert batches.DEMO_QUERY.parent.name in labels.values()


@pytest.mark.slow
def test_the_demonstration_finds_whose_the_new_scan_is(tmp_path: Path) -> None:
    """Outside a checkout, in a folder that has to be made and whose name has to be quoted."""
    done = program(
        "demo", "my demo", cwd=tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "compiled")
    )
    assert done.stderr.count("compiling, once after an installation") == 1
    head, first, *_ = done.stdout.splitlines()
    assert head.split()[:4] == ["RANK", "DISTANCE", "SCORE", "CLASS"]
    assert first.split()[0] == "1"
    assert first.split()[3] == batches.DEMO_QUERY.parent.name, (
        "the nearest scan is one of the same person"
    )
    assert "NN" in done.stdout
    page = Path(unquote(urlparse(done.stderr.split()[-1]).path))
    assert page == tmp_path / "my demo" / "index.html"
    assert page.read_text(encoding="utf-8").count("data:image/png") > 10
    shown = [
        shlex.split(line[2:])
        for line in done.stderr.splitlines()
        if line.startswith("$ ")
    ]
    assert [words[:2] for words in shown] == [
        ["pcretrieve", command] for command in ("ingest", "query", "evaluate", "report")
    ]
    for _, *words in shown:
        assert program(*words, cwd=tmp_path).stdout in done.stdout


def test_a_folder_that_cannot_be_made_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    said = refusal("demo", tmp_path / "file")
    assert (
        f"cannot write scans into {tmp_path / 'file'}: Not a directory; name another"
        in said
    )
