"""Who is answered: requests with the token, of this computer, and of no other site."""

from __future__ import annotations

from pathlib import Path

import pytest
from search_server import Server, raw, running, status

from pcretrieve import serve
from pcretrieve.errors import InputError

pytestmark = pytest.mark.slow

PRIVATE = ("/", "/shapes", "/shapes/Egg00/similar", "/assets/page.css", "/nothing")


def cookie(server: Server) -> str:
    return server.ask(f"/?token={server.token}", bearer=False).headers["set-cookie"]


@pytest.mark.parametrize("path", PRIVATE)
def test_nothing_is_answered_without_the_token(server: Server, path: str) -> None:
    assert server.ask(path, bearer=False).status == 403
    assert server.ask(f"{path}?token=wrong", bearer=False).status == 403
    assert server.ask(path, headers={"Authorization": "Bearer é"}, bearer=False).status == 403
    assert server.ask(path, headers={"Cookie": f"pcretrieve-{server.port}=x"}, bearer=False).status == 403


def test_the_address_gives_the_browser_a_cookie(server: Server) -> None:
    answer = server.ask(f"/shape/Egg00?k=2&token={server.token}", bearer=False)
    assert answer.status == 303
    assert answer.headers["location"] == "/shape/Egg00?k=2"
    value, *attributes = answer.headers["set-cookie"].split("; ")
    assert {"HttpOnly", "SameSite=Strict", "Path=/"} == set(attributes)
    again = server.ask("/shape/Egg00?k=2", headers={"Cookie": value}, bearer=False)
    assert again.status == 200
    assert server.token.encode() not in again.body


def test_the_token_does_not_lead_to_other_sites(server: Server) -> None:
    for path in ("//evil.example/", "/\\evil.example/", "///evil.example"):
        location = server.ask(f"{path}?token={server.token}", bearer=False).headers["location"]
        assert location.startswith("/")
        assert location[1] not in "/\\"


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example", "", "[", "169.254.1.1:80"])
def test_foreign_names_of_the_host_are_refused(server: Server, host: str) -> None:
    assert server.ask("/", headers={"Host": host}).status == 400


@pytest.mark.parametrize("host", ["localhost:8000", "127.0.0.1", "[::1]:9"])
def test_names_of_this_computer_are_answered(server: Server, host: str) -> None:
    assert server.ask("/", headers={"Host": host}).status == 200


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:1", "file://"])
def test_foreign_origins_are_refused(server: Server, origin: str) -> None:
    assert server.ask("/shapes", headers={"Origin": origin}).status == 403
    own = {"Origin": f"http://127.0.0.1:{server.port}"}
    assert server.ask("/shapes", headers=own).status == 200


def test_pages_may_use_this_server_alone(server: Server) -> None:
    for path in (*PRIVATE, "/shapes/none"):
        headers = server.ask(path).headers
        policy = headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "same-origin"
        assert "server" not in headers
        assert headers["server-timing"].startswith("total;dur=")
    page = server.ask("/shape/Egg00").body
    assert b"http://" not in page
    assert b"https://" not in page
    assert b"<style" not in page
    assert b"style=" not in page
    assert b"onclick" not in page


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "TRACE"])
def test_other_methods_are_refused(server: Server, method: str) -> None:
    assert server.ask("/shapes/Egg00", method=method).status == 405
    own = cookie(server).split(";")[0]
    assert server.ask("/", method=method, headers={"Cookie": own}, bearer=False).status == 403


def test_the_server_listens_at_this_computer_only_and_tokens_are_new(server: Server, eggs: Path) -> None:
    with running(eggs, "--whitening", "pca") as other:
        assert other.address.startswith("http://127.0.0.1:")
        assert other.token != server.token
        assert len(other.token) >= 32
        assert "pca" in other.ask("/shapes/Egg00/similar").json["whitening"]


def test_a_used_port_is_said(server: Server, eggs: Path) -> None:
    with pytest.raises(InputError, match=f"cannot serve at port {server.port}: .* give another --port"):
        serve(eggs, port=server.port)


def test_no_wrong_token_is_nearer_than_another(server: Server) -> None:
    right = server.token
    near = [right[:-1], right + "x", right[:-1] + chr(ord(right[-1]) ^ 1), right.swapcase(), "", "x" * 9000]
    answers = [
        answer
        for token in near
        for answer in (
            server.ask(f"/?token={token}", bearer=False),
            server.ask("/", headers={"Authorization": f"Bearer {token}"}, bearer=False),
            server.ask("/", headers={"Cookie": f"pcretrieve-{server.port}={token}"}, bearer=False),
            server.ask("/", headers={"Authorization": f"Basic {right}"}, bearer=False),
        )
    ]
    assert {(answer.status, answer.body) for answer in answers} == {(403, answers[0].body)}
    assert {answer.headers["connection"] for answer in answers} == {"close"}


@pytest.mark.parametrize("given", ["x%0d%0aX-Evil:%201", "%E2%82%AC", "x;%20Path=/shape", "wrong", ""])
def test_an_address_changes_no_cookie(server: Server, given: str) -> None:
    own = f"pcretrieve-{server.port}={server.token}"
    answer = server.ask(f"/?token={given}", headers={"Cookie": own}, bearer=False)
    assert answer.status == 303
    assert answer.headers["location"] == "/"
    assert answer.headers["set-cookie"] == f"{own}; Path=/; HttpOnly; SameSite=Strict"
    assert "x-evil" not in answer.headers


@pytest.mark.parametrize(
    "cookies",
    ['a={"b": [1, 2]}; NAME=TOKEN', "NAME=TOKEN; a=[;]", "NAME=evil; NAME=TOKEN", ";;=;NAME=TOKEN; é"],
)
def test_cookies_of_other_programs_lock_nobody_out(server: Server, cookies: str) -> None:
    own = {"NAME": f"pcretrieve-{server.port}", "TOKEN": server.token}
    sent = cookies.replace("NAME", own["NAME"]).replace("TOKEN", own["TOKEN"])
    assert server.ask("/", headers={"Cookie": sent}, bearer=False).status == 200


@pytest.mark.parametrize("token", ["a b", "a;b", "a\nb", "é", "a/b"])
def test_a_token_is_part_of_an_address(eggs: Path, token: str) -> None:
    with pytest.raises(InputError, match="the token must be ASCII letters"):
        serve(eggs, token=token, port=0)


@pytest.mark.parametrize(
    "head",
    [
        "Host: evil.example\r\nHost: 127.0.0.1",
        "Host: 127.0.0.1@evil.example",
        "Host: 127.0.0.1.nip.io",
        "Host: 2130706433",
        "Host: 0.0.0.0",
        "X-Forwarded-Host: 127.0.0.1\r\nHost: evil.example",
        "Origin: http://127.0.0.1\r\nHost: evil.example",
    ],
)
def test_names_that_are_made_to_mean_this_computer(server: Server, head: str) -> None:
    token = f"Authorization: Bearer {server.token}"
    assert status(raw(server, f"GET / HTTP/1.1\r\n{head}\r\n{token}\r\n\r\n")) == 400


def test_a_method_is_not_replaced_by_a_header(server: Server) -> None:
    own = {"Cookie": f"pcretrieve-{server.port}={server.token}"}
    for name in ("X-HTTP-Method-Override", "X-HTTP-Method", "X-Method-Override"):
        assert server.ask("/scans?name=a.off", headers={name: "POST"}).status == 405
    for method in ("post", "Get", "CONNECT", "PATCH", "GETX"):
        answer = server.ask("/shapes", method=method, headers=own, bearer=False)
        assert answer.status == 403
    for path in ("/scans?name=a.off", f"/scans?name=a.off&token={server.token}"):
        assert server.ask(path, method="POST", body=b"OFF", headers=own, bearer=False).status == 403
    upgrade = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13"}
    assert server.ask("/", headers={**upgrade, "Sec-WebSocket-Key": 16 * "x"}, bearer=False).status == 403
