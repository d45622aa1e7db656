"""Scans from browsers: received up to a size, processed apart, answered, and removed."""

from __future__ import annotations

import json
from pathlib import Path
from tempfile import gettempdir

import pytest
import shapes
from processes import wait_for
from search_server import Server, running

from pcretrieve import search, write_mesh

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scans") / "egg.off"
    write_mesh(shapes.ellipsoid((1.06, 1, 1.8), 3), path)
    return path


def job_of(server: Server, scan: bytes, name: str) -> dict[str, object]:
    """The document of a job that has ended."""
    begun = server.ask(f"/scans?name={name}", method="POST", body=scan)
    assert begun.status == 202, begun.body
    address = begun.headers["location"]
    assert wait_for(lambda: server.ask(address).json["state"] in ("done", "failed"))
    document: dict[str, object] = server.ask(address).json
    return document


def test_a_scan_is_answered_as_by_the_library_and_removed(server: Server, scan: Path, eggs: Path) -> None:
    before = set(Path(gettempdir()).glob("pcretrieve-*"))
    job = job_of(server, scan.read_bytes(), "my%20%3Cb%3E.OFF")
    assert job["state"] == "done", job
    assert job["name"] == "my <b>.OFF"
    stages = [step["stage"] for step in job["stages"]]  # type: ignore[attr-defined]
    assert {"read", "spectrum", "checks"} <= set(stages)
    found = server.ask(f"/scans/{job['job']}/similar?k=5").json
    expected = search(eggs, scan, k=5)
    assert [row["id"] for row in found["results"]] == list(expected.ids)
    assert [row["distance"] for row in found["results"]] == pytest.approx(expected.distances.tolist())
    page = server.ask(f"/scan/{job['job']}").body
    assert b"my &lt;b&gt;.OFF" in page
    assert found["results"][0]["id"].encode() in page
    assert server.ask(f"/scans/{job['job']}/similar.csv").body.startswith(b"query,rank,id")
    events = server.ask(f"/scans/{job['job']}/events")
    assert events.headers["content-type"].startswith("text/event-stream")
    *_, last = (json.loads(event) for event in events.body.decode().split("data: ") if event)
    assert last == job | {"inspection": "done"}

    def left() -> list[Path]:
        new = set(Path(gettempdir()).glob("pcretrieve-*")) - before
        return [path for folder in new for path in folder.rglob("*.off")]

    assert wait_for(lambda: not left())


def test_a_scan_that_cannot_be_read_fails_alone(server: Server) -> None:
    job = job_of(server, b"OFF\n1 1 1\nnothing", "bad.off")
    assert job["state"] == "failed"
    assert job["error"] == "ScanReadError"
    assert gettempdir() not in str(job)
    assert b"failed" in server.ask(f"/scan/{job['job']}").body
    assert server.ask(f"/scans/{job['job']}/similar").status == 400


@pytest.mark.parametrize(
    "name",
    [
        "",
        "scan",
        "scan.zip",
        "scan.npz",
        "scan.3mf",
        "scan.conf",
        "scan.gltf",
        "scan.off.php",
        "off",
        "x" * 300 + ".off",
    ],
)
def test_other_files_are_refused(server: Server, name: str) -> None:
    answer = server.ask(f"/scans?name={name}", method="POST", body=b"OFF")
    assert answer.status == 400
    assert "suffixes .ply" in answer.json["message"]


def test_names_are_no_paths(server: Server) -> None:
    job = job_of(server, b"OFF", "..%2F..%2Fscan.off")
    assert job["state"] == "failed"
    assert not Path("../../scan.off").exists()


def test_sizes_are_limited_before_a_scan_is_read(eggs: Path) -> None:
    with running(eggs, "--max-upload", "1") as small:
        assert small.ask("/scans?name=a.ply", method="POST", body=b"").status == 400
        announced = {"Content-Length": "1000001"}
        # The body is shorter than announced: the answer comes before the body.
        assert small.ask("/scans?name=a.ply", method="POST", body=b"x", headers=announced).status == 413
        chunks = iter([bytes(250_000)] * 4 + [b"x"])
        assert small.ask("/scans?name=a.ply", method="POST", body=chunks).status == 413
    with running(eggs, "--read-only") as closed:
        assert closed.ask("/scans?name=a.off", method="POST", body=b"OFF").status == 404
        assert b'id="upload"' not in closed.ask("/").body


def test_a_form_of_another_site_uploads_nothing(server: Server) -> None:
    own = server.ask(f"/?token={server.token}", bearer=False).headers["set-cookie"].split(";")[0]
    for origin in ({}, {"Origin": "http://evil.example"}, {"Origin": "null"}):
        answer = server.ask(
            "/scans?name=a.off", method="POST", body=b"OFF", headers={"Cookie": own, **origin}, bearer=False
        )
        assert answer.status == 403
