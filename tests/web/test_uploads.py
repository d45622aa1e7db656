"""Uploaded scans: hostile files, names and requests are refused in words; others are answered, and kept.

The files and the names are those of the OWASP File Upload Cheat Sheet.
"""

from __future__ import annotations

import csv
import io
import json
import os
import re
import shutil
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import product
from pathlib import Path
from urllib.parse import urlencode

import pytest
from commands import refusal
from processes import PATIENCE, wait_for
from scan_files import HOSTILE, REFERENCES
from search_server import Server, egg, raw, running, status

from pcretrieve import Answer, search

pytestmark = pytest.mark.slow

# Names that are refused whatever the file has.
REFUSED = [
    *("", "scan", "off", "x" * 300 + ".off"),
    *(
        "a.off.zip",
        "a.zip",
        "a.tar.gz",
        "a.npz",
        "a.3mf",
        "a.dae",
        "a.x3d",
        "a.gltf",
        "a.glb",
        "a.conf",
    ),
    *(
        "a.off\0.png",
        "a.off%00.png",
        "a.off.",
        "a.off ",
        "a.off;.php",
        "a.off:$DATA",
        "a.off::$INDEX",
    ),
    *(
        "a.html",
        "a.svg",
        "a.php",
        "a.exe",
        "a.txt",
        "a.wrl",
        ".htaccess",
        ".off",
        "..",
        "/etc/passwd",
        "con",
    ),
]

# Names that are words for people, and of no file.
WORDS = [
    *(
        "../../../a.off",
        "..\\..\\a.off",
        "/etc/cron.d/a.off",
        "file:///etc/passwd.off",
        "a.png\0.off",
    ),
    *(
        "<img src=x onerror=alert(1)>.off",
        "\"'><script>alert(1)</script>.off",
        "$(id)`id`;id|id.off",
    ),
    *(
        "a\r\nSet-Cookie: x=y\r\n\r\n.off",
        "\u202eply.exe.off",
        "=HYPERLINK(1).off",
        "a#1.off",
        "nul.off",
    ),
]

UP = [
    *(
        "../",
        "..%2F",
        "%2e%2e%2f",
        "..%5c",
        "....//",
        "..%252f",
        "%c0%ae%c0%ae/",
        "..%00/",
    ),
    *("//", "file:%2F%2F%2F"),
]


@pytest.fixture(scope="module")
def temporary(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("with blanks ") / "temporary files"


@pytest.fixture(scope="module")
def started(eggs: Path, temporary: Path) -> Iterator[Server]:
    temporary.mkdir()
    with running(eggs, "--max-upload", "2", temporary=temporary) as server:
        yield server


@pytest.fixture
def target(started: Server, temporary: Path) -> Iterator[Server]:
    """A server that answers after each attack, and has kept no file."""
    yield started
    assert started.ask("/shapes/Egg00/similar?k=1").json["neighbors"][0]["id"] == "Egg01"
    assert wait_for(lambda: not scans_in(temporary))


def scans_in(place: Path) -> list[Path]:
    # By `walk`, which passes over folders that the server removes meanwhile.
    return [
        Path(folder, name)
        for folder, _, names in os.walk(place)
        for name in names
        if name.lower().endswith((".off", ".ply", ".obj"))
    ]


# --- files ------------------------------------------------------------------------------------------------


def test_hostile_files_are_refused_in_words_and_inspected(target: Server) -> None:
    for name, body, words in HOSTILE:
        job = target.outcome(name, body)
        # No scan, of which nothing can be shown.
        is_other = words in ("Python objects", "not a valid NPY")
        assert (job["state"], job["inspection"]) == (
            "failed",
            "failed" if is_other else "done",
        )
        assert job["error"] in ("ScanReadError", "ReconstructionError")
        assert words in job["message"]
        page = target.ask(f"/scan/{job['job']}/inspection").body.decode()
        assert is_other or f"No signature, the {job['stage']} stage failed" in page
        assert target.ask(f"/scans/{job['job']}/thumbnail.png").status == 404
        assert not Path("pickled").exists()


def test_files_that_a_scan_refers_to_are_not_opened(target: Server) -> None:
    with socket.create_server(("127.0.0.1", 0)) as elsewhere:
        port = elsewhere.getsockname()[1]
        assert (
            target.outcome("a.obj", REFERENCES.format(port=port).encode())["state"]
            == "failed"
        )
        assert (
            target.outcome(f"http://127.0.0.1:{port}/a.off", b"OFF")["state"] == "failed"
        )
        assert (
            target.ask(f"/shapes/http:%2F%2F127.0.0.1:{port}%2Fa.off/similar").status
            == 404
        )
        elsewhere.setblocking(False)
        with pytest.raises(BlockingIOError):
            elsewhere.accept()


# --- names ------------------------------------------------------------------------------------------------


def test_names_say_what_kind_of_file_it_is_and_are_of_no_file(target: Server) -> None:
    for name in REFUSED:
        answer = target.send(name, b"OFF")
        assert answer.status == 400
        assert "a scan must be a file with one of the suffixes" in answer.json["message"]
    for name in WORDS:
        job = target.outcome(name, b"OFF")
        assert job["name"] == name
        assert job["message"].startswith(f"{job['name']}: not a valid OFF file")


def test_addresses_lead_to_no_file(target: Server) -> None:
    for place, up in product(("shapes", "shape", "scans", "scan", "assets"), UP):
        for end in ("etc/passwd", "etc%2Fpasswd", "pyproject.toml"):
            assert target.ask(f"/{place}/{6 * up}{end}").status == 404
            assert target.ask(f"/{place}/{6 * up}{end}/similar").status == 404
            assert target.ask(f"/compare?a=Egg00&b={6 * up}{end}").status == 404


def test_fields_are_no_markup(target: Server) -> None:
    fields = [
        "q",
        "label",
        "state",
        "since",
        "until",
        "sort",
        "page",
        "k",
        "min_score",
        "a",
        "b",
    ]
    paths = [
        "/?",
        "/map?",
        "/shape/Egg00?",
        "/compare?a=Egg00&",
        "/shapes?",
        "/shapes/Egg00/similar?",
    ]
    for path, field in product(paths, fields):
        answer = target.ask(path + urlencode({field: "\"'><script>alert(1)</script>"}))
        assert answer.status in (200, 400, 404)
        kind = answer.headers["content-type"]
        assert kind == "application/json" or (
            b"<script>alert" not in answer.body and "text/html" in kind
        )


# --- sizes and times --------------------------------------------------------------------------------------


UPLOAD = "POST /scans?name=a.off HTTP/1.1\r\nKNOWN\r\n"


def test_lengths_are_known_and_limited_before_a_scan_is_read(target: Server) -> None:
    for length in ("-1", "1e3", "0x10", "", "3\r\nContent-Length: 4", "9" * 5000):
        assert status(
            raw(target, f"{UPLOAD}Content-Length: {length}\r\n\r\n", b"OFF")
        ) in (
            400,
            413,
        )
    assert target.send("a.ply", b"").status == 400
    # The body is shorter than announced: the answer comes before the body.
    assert target.send("a.ply", b"x", headers={"Content-Length": "2000001"}).status == 413
    assert target.send("a.ply", iter([bytes(500_000)] * 4 + [b"x"])).status == 413


def test_uploads_wait_in_a_queue_of_limited_length(target: Server) -> None:
    with ExitStack() as stack:
        request = f"{UPLOAD}Content-Length: 1000\r\n\r\n"
        sent = [stack.enter_context(raw(target, request, b"OFF")) for _ in range(8)]
        assert wait_for(lambda: target.send("a.off", b"OFF").status == 503)
        assert "8 scans are waiting" in target.send("a.off", b"OFF").json["message"]
        assert target.ask("/").status == 200
        assert len(sent) == 8
    assert wait_for(lambda: target.send("a.off", b"OFF").status == 202)


def test_slow_and_endless_bodies_are_given_up(eggs: Path, tmp_path: Path) -> None:
    limits = (
        "import pcretrieve.web.requests as u; u.RECEIVING_TIMEOUT = 0.5; "
        "import pcretrieve.web.application as a; a.LINGER = 0.5"
    )
    with running(eggs, "--max-upload", "1", first=limits, temporary=tmp_path) as server:
        slow = [
            raw(server, f"{UPLOAD}Content-Length: 1000\r\n\r\n", b"OFF") for _ in range(8)
        ]
        assert [status(connection) for connection in slow] == [408] * 8
        assert server.send("a.off", b"OFF").status == 202
        assert wait_for(lambda: not scans_in(tmp_path))
        for begun, more in (
            (
                f"{UPLOAD}Transfer-Encoding: chunked\r\n\r\n",
                b"10000\r\n" + bytes(0x10000) + b"\r\n",
            ),
            (f"{UPLOAD}Content-Length: {10**15}\r\n\r\n", bytes(0x10000)),
            ("GET / HTTP/1.1\r\nKNOWN\r\nX: ", b"x" * 0x10000),
        ):
            end = time.monotonic() + PATIENCE
            with (
                raw(server, begun) as endless,
                pytest.raises(ConnectionError),
            ):  # the server closes it
                while time.monotonic() < end:
                    endless.sendall(more)
        assert server.ask("/").status == 200


def test_connections_without_a_request_are_closed(eggs: Path) -> None:
    limits = (
        "import pcretrieve.web.server as s; s.FIRST_REQUEST = 0.5; s.MOST_CONNECTIONS = 4"
    )
    with running(eggs, first=limits) as server, ExitStack() as stack:
        for begun in ("", "G", "GET / HTTP/1.1\r\n", "GET / HTTP/1.1\r\nX: y\r\n") * 2:
            stack.enter_context(raw(server, begun))
        assert wait_for(lambda: server.ask("/").status == 200)


# --- what is not an attack --------------------------------------------------------------------------------


def test_a_scan_is_answered_as_by_the_library_and_inspected(
    target: Server, eggs: Path, tmp_path: Path
) -> None:
    """It is what its bytes say, not its headers; and its name is no part of a header or of a page."""
    name = 'a\r\nSet-Cookie: x=y\r\n\r\n<b>,".OFF'
    headers = {
        "Content-Type": "multipart/form-data; boundary=x",
        "Content-Encoding": "gzip",
    }
    job = target.outcome(name, egg(tmp_path), headers=headers)
    assert (job["state"], job["inspection"], job["kept_as"], job["name"]) == (
        "done",
        "done",
        None,
        name,
    )
    assert {"read", "spectrum", "checks"} <= {step["stage"] for step in job["stages"]}
    data, page = f"/scans/{job['job']}", f"/scan/{job['job']}"
    found, expected = (
        target.ask(f"{data}/similar?k=5").json,
        search(eggs, tmp_path / "egg.off", k=5).neighbors,
    )
    assert [row["id"] for row in found["neighbors"]] == list(expected.ids)
    assert [row["distance"] for row in found["neighbors"]] == pytest.approx(
        expected.distances.tolist()
    )
    table = target.ask(f"{data}/similar.csv?k=1")
    assert table.headers["content-disposition"] == 'attachment; filename="similar.csv"'
    assert table.headers["content-type"].startswith("text/csv")
    assert "set-cookie" not in table.headers
    head, row = csv.reader(io.StringIO(table.body.decode(), newline=""))
    assert (tuple(head), row[0], row[1]) == (Answer.columns, name, found["verdict"])
    events = target.ask(f"{data}/events")
    assert events.headers["content-type"].startswith("text/event-stream")
    *_, last = (
        json.loads(event) for event in events.body.decode().split("data: ") if event
    )
    assert last == job
    picture = target.ask(f"{data}/thumbnail.png")
    assert picture.headers["content-type"] == "image/png" and picture.body.startswith(
        b"\x89PNG"
    )
    said = target.ask(page).body.decode()
    assert (
        "&lt;b&gt;" in said
        and found["neighbors"][0]["id"] in said
        and f'href="{page}/inspection"' in said
    )
    assert "/keep" not in said, "this server keeps nothing"
    refused = target.ask(f"{data}/keep?id=mine", method="POST")
    assert refused.status == 404
    assert (
        "this server keeps no scans: start it with --keep FOLDER"
        in refused.json["message"]
    )
    answer = target.ask(f"{page}/inspection")
    inspection = answer.body.decode()
    assert "&lt;b&gt;" in inspection and "From four sides" in inspection
    # What the content policy of the server would not let the browser do.
    assert not re.findall(r"<style|style=|<script>|\son\w+=", inspection)
    assert "'unsafe-inline'" not in inspection + answer.headers["content-security-policy"]


# --- keeping ----------------------------------------------------------------------------------------------


@pytest.fixture
def keeper(eggs: Path, tmp_path: Path) -> Iterator[Server]:
    """A server that may change its catalogue, and keeps scans in a folder."""
    folder, temporary = tmp_path / "kept", tmp_path / "temporary"
    folder.mkdir()
    temporary.mkdir()
    collection = Path(shutil.copy(eggs, tmp_path / "collection.sqlite"))
    with running(collection, "--keep", str(folder), temporary=temporary) as server:
        yield server


NOT_KEPT: list[tuple[dict[str, str], str]] = [
    *(
        ({"id": name}, "a name must be letters")
        for name in ("", "../../evil", "/etc/passwd", ".hidden", "a*", "x" * 101, "a\0b")
    ),
    ({}, "a name must be letters"),
    ({"id": "Egg00"}, "there is a shape 'Egg00' already"),
    ({"id": "fine", "label": "a\nb"}, "a class must be"),
    ({"id": "fine", "label": "x" * 201}, "a class must be"),
]


def test_nobody_else_and_under_no_other_name_may_have_a_scan_kept(
    keeper: Server, tmp_path: Path
) -> None:
    job = keeper.outcome("egg.off", egg(tmp_path))
    for fields, said in NOT_KEPT:
        refused = keeper.ask(
            f"/scans/{job['job']}/keep?{urlencode(fields)}", method="POST"
        )
        assert refused.status == 400, (fields, refused.body)
        assert said in refused.json["message"]
        by_form = keeper.ask(
            f"/scan/{job['job']}/keep", method="POST", body=urlencode(fields).encode()
        )
        assert by_form.status == 400 and b"<main" in by_form.body, fields
    cookie = (
        keeper.ask(f"/?token={keeper.token}", bearer=False)
        .headers["set-cookie"]
        .split(";")[0]
    )
    for headers in (
        {},
        {"Cookie": cookie},
        {"Cookie": cookie, "Origin": "http://evil.example"},
    ):
        for address in (f"/scans/{job['job']}/keep?id=evil", f"/scan/{job['job']}/keep"):
            answer = keeper.ask(
                address, method="POST", body=b"id=evil", headers=headers, bearer=False
            )
            assert answer.status == 403
    long = keeper.ask(
        f"/scan/{job['job']}/keep", method="POST", body=b"id=" + b"x" * 20_000
    )
    assert long.status == 413
    assert [*(tmp_path / "kept").iterdir()] == []
    assert keeper.ask("/shapes").json["total"] == 13
    assert keeper.ask(f"/scans/{job['job']}").json["kept_as"] is None


def test_what_failed_is_not_kept_and_uploads_end_with_the_server(
    keeper: Server, tmp_path: Path
) -> None:
    keeper.outcome("egg.off", egg(tmp_path))
    bad = keeper.outcome("bad.off", b"OFF\n1 1 1\nnothing")
    for job in (bad["job"], "none"):
        assert keeper.ask(f"/scans/{job}/keep?id=three", method="POST").status == 404
    assert scans_in(tmp_path / "temporary"), "until it is too late to ask for it"
    keeper.process.terminate()
    keeper.process.wait(60)
    assert not scans_in(tmp_path / "temporary")


def test_a_server_that_only_reads_takes_and_keeps_no_scan(
    eggs: Path, tmp_path: Path
) -> None:
    with running(eggs, "--read-only") as closed:
        assert closed.send("a.off", b"OFF").status == 404
        assert b'id="upload"' not in closed.ask("/").body
    words = refusal("serve", "-c", eggs, "--read-only", "--keep", tmp_path)
    assert "choose one of --read-only and --keep" in words


def test_what_a_killed_server_leaves_is_removed_by_the_next(
    keeper: Server, tmp_path: Path
) -> None:
    temporary = tmp_path / "temporary"
    keeper.outcome("egg.off", egg(tmp_path))
    keeper.process.kill()
    keeper.process.wait(60)
    assert scans_in(temporary)
    with running(tmp_path / "collection.sqlite", temporary=temporary) as server:
        assert server.ask("/shapes").status == 200
        assert not scans_in(temporary)
