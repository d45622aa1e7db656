"""`pcretrieve serve`: pages and documents of a server in a process of its own."""

from __future__ import annotations

import re
import shutil
import socket
import sqlite3
from contextlib import closing
from dataclasses import replace
from html import escape, unescape
from pathlib import Path
from urllib.parse import quote, urlencode

import pytest
from commands import program
from search_server import NASTY, Answer, Server, running, write_eggs

from pcretrieve import Catalogue
from pcretrieve.catalogue import Record
from pcretrieve.pages.html import without_folders


def ids(page: bytes) -> list[str]:
    """The names on the cards of a page."""
    found = re.findall(
        r"<b>(?:<span class=\"soft\">\d+</span> )?(.*?)</b></a>", page.decode()
    )
    return [unescape(name) for name in found]


LISTINGS: list[tuple[str, list[str]]] = [
    ("q=gG0", ["Egg00", "Egg01", "Egg02", "Egg03"]),
    ("q=egg+3&sort=-id", ["Egg23", "Egg13", "Egg03"]),
    ("state=incomplete", ["Egg23"]),
    ("state=failed", ["broken"]),
    ("label=%3Ckind+2%3E&state=done", ["Egg20", "Egg21", "Egg23", NASTY]),
    ("sort=-label&q=0", ["Egg20", "Egg10", "Egg03", "Egg02", "Egg01", "Egg00"]),
    ("q=nothing", []),
    ("page=2", []),
    ("since=2999-01-01", []),
    ("until=2000-01-01", []),
    ("q=egg0&since=2000-01-01&until=2999-01-01", ["Egg00", "Egg01", "Egg02", "Egg03"]),
    ("q=3&sort=-error", ["Egg23", "Egg13", "Egg03"]),
    ("q=egg0&sort=-added", ["Egg03", "Egg02", "Egg01", "Egg00"]),
]


def test_the_collection_is_searched_filtered_and_sorted(server: Server) -> None:
    for query, expected in LISTINGS:
        found = ids(server.ask(f"/?{query}").body)
        assert found == [
            shape["id"] for shape in server.ask(f"/shapes?{query}").json["shapes"]
        ]
        assert found == expected


def test_a_day_of_the_collection_includes_its_last_hour(server: Server) -> None:
    every = server.ask("/shapes").json["shapes"]
    days = sorted({shape["added"][:10] for shape in every})
    for first, last in ((days[0], days[-1]), (days[-1], days[-1])):
        found = server.ask(f"/shapes?since={first}&until={last}").json["shapes"]
        assert (
            found
            == [shape for shape in every if first <= shape["added"][:10] <= last]
            != []
        )


@pytest.mark.slow
def test_any_name_is_one_part_of_an_address(server: Server) -> None:
    name = quote(NASTY, safe="")
    assert server.ask(f"/shapes/{name}").json["id"] == NASTY
    page = server.ask(f"/shape/{name}").body.decode()
    assert unescape(re.findall("<h1>(.*)</h1>", page)[0]) == NASTY
    assert server.ask(f"/shapes/{name}/thumbnail.png").body.startswith(b"\x89PNG")
    links = re.findall(r'(?:href|src)="(/[^"]*)"', page)
    assert {server.ask(unescape(link)).status for link in set(links)} == {200}


# Every kind of answer; no one of them has a folder of the server, see `Server`.
ADDRESSES = {
    200: [
        *(
            "/",
            "/map",
            "/shapes",
            "/shapes/broken",
            "/shape/Egg00",
            "/shape/broken",
            "/shapes/Egg00/similar",
        ),
        *(
            "/shapes/Egg00/similar.csv",
            "/shapes/Egg00/scene?than=Egg20",
            "/shapes/Egg00/mesh.glb",
        ),
        *("/compare?a=Egg00&b=Egg01", "/compare", "/compare?a=Egg00", "/?sort=-error"),
    ],
    400: [
        *(
            "/shapes/Egg00/similar?k=0",
            "/shapes/Egg00/similar?k=1e9",
            "/shapes/Egg00/similar?min_score=nan",
        ),
        *("/shapes/Egg00/similar?label=none", "/?sort=path", "/?page=" + 5000 * "9"),
        "/compare?a=Egg00&b=broken",
    ],
    404: [
        "/shapes/README.md/similar",  # a file of this folder, which `pcretrieve query` would read
        *("/shapes/none", "/shapes/none/similar", "/shape/none", "/shapes/none/mesh.glb"),
        *(
            "/shapes/broken/mesh.glb",
            "/scans/none",
            "/nothing",
            "//evil.example",
        ),
        *("/assets/../html.py", "/assets/..%2Fhtml.py"),
    ],
}


def test_sizes_of_compared_shapes_name_their_unit(server: Server) -> None:
    for pair, said in (
        ("a=Egg10&b=Egg11", "&nbsp;m²</td>"),
        ("a=Egg00&b=Egg10", "volume / √area³</th>"),
    ):
        page = server.ask(f"/compare?{pair}").body.decode()
        assert said in page and ("no common unit" in page) == ("Egg00" in pair)


@pytest.mark.slow
def test_what_cannot_be_answered_is_said(server: Server) -> None:
    assert Path("README.md").exists()
    for status, paths in ADDRESSES.items():
        for path in paths:
            answer = server.ask(path)
            assert answer.status == status, path
            if status != 200 and path.startswith(("/shapes", "/scans")):
                assert set(answer.json) == {"error", "message"}
    for field in ("state", "since", "until", "sort", "page"):
        assert field in server.ask(f"/shapes?{field}=%3F").json["message"]


def test_the_worst_scans_are_first_and_classes_have_their_sizes(server: Server) -> None:
    page = server.ask("/?sort=-error").body.decode()
    assert ids(page.encode())[:2] == ["broken", "Egg23"]
    assert "show all" not in page
    assert b"show all" in server.ask("/?sort=-error&state=done").body
    assert "<b>incomplete</b>: a large hole" in page
    assert re.findall(r'&lt;kind (\d)&gt; <span class="soft">(\d+)</span>', page) == [
        ("0", "4"),
        ("1", "4"),
        ("2", "4"),
    ]


def test_no_page_says_none(server: Server) -> None:
    for path in (*ADDRESSES[200], *ADDRESSES[400], *ADDRESSES[404]):
        text = server.ask(path)
        if text.headers["content-type"].startswith("text/html"):
            words = unescape(re.sub(r"<[^>]*>", " ", text.body.decode()))
            assert "None" not in words.split(), path


def test_a_missing_id_is_asked_for(server: Server) -> None:
    page = server.ask("/compare?a=Egg00").body.decode()
    assert 'name="a" value="Egg00"' in page and '<option value="Egg01">' in page


def test_the_file_of_a_shape_is_inspected_where_it_is(server: Server) -> None:
    gone = server.ask("/shape/Egg00/inspect", method="POST")
    assert gone.status == 404 and b"is not there any more" in gone.body
    assert b"Inspect this scan" not in server.ask("/shape/Egg00").body


def decide(server: Server, name: str, **fields: str) -> Answer:
    """The answer to the form of a page, as a browser sends it."""
    return server.ask(
        f"/shape/{quote(name, safe='')}/mark",
        method="POST",
        body=urlencode(fields).encode(),
    )


def test_a_decision_is_kept_shown_and_forgotten(server: Server, eggs: Path) -> None:
    """Of a failed scan too; the command line sees the same."""
    note = "<b>left foot</b> & 5 %"
    for name in ("Egg01", "broken", NASTY):
        done = decide(server, name, decision="rescan", note=note)
        assert done.status == 303
        assert done.headers["location"] == f"/shape/{quote(name, safe='')}"
        page = server.ask(done.headers["location"]).body.decode()
        assert f'<p class="marked"><b>scan again</b>: {escape(note)}</p>' in page
        assert 'value="rescan" aria-pressed="true"' in page
    assert {*ids(server.ask("/?marked=rescan").body)} == {"Egg01", "broken", NASTY}
    assert server.ask("/").body.decode().count("<b>scan again</b>") == 3
    with Catalogue(eggs) as store:
        assert (store.record(NASTY).mark, store.record(NASTY).note) == ("rescan", note)
    decide(server, "Egg01", decision="accept", note="")
    assert server.ask("/shapes/Egg01").json["mark"] == "accept"
    assert ids(server.ask("/?marked=accept").body) == ["Egg01"]
    for name in ("Egg01", "broken", NASTY):
        decide(server, name, decision="", note="")
    assert ids(server.ask("/?marked=any").body) == []
    assert b'class="marked"' not in server.ask("/").body


def test_who_may_not_decide_and_what_is_no_decision(server: Server, eggs: Path) -> None:
    assert decide(server, "Egg01", decision="burn").status == 400
    assert b"must have a text" in decide(server, "Egg01", decision="note").body
    assert decide(server, "Egg01", decision="note", note="x" * 10_000).status == 413
    assert decide(server, "nobody", decision="accept").status == 404

    def accepted(headers: dict[str, str]) -> int:
        return server.ask(
            "/shape/Egg01/mark",
            method="POST",
            body=b"decision=accept",
            headers=headers,
            bearer=False,
        ).status

    cookie = {"Cookie": f"pcretrieve-{server.port}={server.token}"}
    for headers in (
        {},
        cookie,
        cookie | {"Origin": "http://127.0.0.1:1"},
        cookie | {"Origin": "http://evil.example"},
    ):
        assert accepted(headers) == 403
    own = cookie | {"Origin": f"http://127.0.0.1:{server.port}"}
    with running(eggs, "--read-only") as closed:
        assert decide(closed, "Egg01", decision="accept").status == 404
        assert b"/mark" not in closed.ask("/shape/Egg01").body
    assert server.ask("/shapes/Egg01").json["mark"] is None
    assert accepted(own) == 303
    assert server.ask("/shapes/Egg01").json["mark"] == "accept"
    decide(server, "Egg01")


def test_a_damaged_row_is_told(eggs: Path, tmp_path: Path) -> None:
    with (
        running(path := Path(shutil.copy(eggs, tmp_path))) as other,
        closing(sqlite3.connect(path)) as file,
    ):
        file.execute("UPDATE provenance SET versions = 'x'")
        file.commit()
        answer = other.ask("/shapes/Egg00")
        assert (
            answer.status == 500
            and b"repair it: `pcretrieve catalogue check --repair`" in answer.body
        )


def test_messages_name_no_folder() -> None:
    for message, told in (
        ("cannot read:/own folder/of scans/a.ply", "cannot read:a.ply"),
        (
            "open('/srv/x/a.ply', \"/srv/y\") or file:/srv/z/b",
            "open('a.ply', \"y\") or file:b",
        ),
        (
            "see https://example.org/a/b, 3/4 and and/or",
            "see https://example.org/a/b, 3/4 and and/or",
        ),
    ):
        assert without_folders(message, Path("/own folder/of scans")) == told


def test_a_catalogue_of_failures_is_served(tmp_path: Path) -> None:
    """The page has the failures; whom a scan shows, nobody can say."""
    with Catalogue(tmp_path / "c.sqlite", create=True) as store:
        failed = Record(
            "bad", "/bad.off", "", status="failed", stage="read", error="ScanReadError"
        )
        store.put(replace(failed, message="it is empty"))
    with running(tmp_path / "c.sqlite") as server:
        assert ids(server.ask("/").body) == ["bad"]
        assert b"it is empty" in server.ask("/shape/bad").body
        assert server.ask("/map").status < 500


def test_a_server_speaks_when_it_listens(tmp_path: Path) -> None:
    """What it cannot do, such as to take a port of another program, is all that it says."""
    write_eggs(tmp_path / "c.sqlite")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        words = ("serve", "-c", tmp_path / "c.sqlite", "--port", taken.getsockname()[1])
        done = program(*words, code=1)
    assert done.stderr.startswith("Error: cannot serve at port")
    assert len(done.stderr.splitlines()) == 1 and not done.stdout
