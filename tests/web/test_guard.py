"""Who is answered: requests with the token, of this computer, and of no other site."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest
from search_server import Server, raw, running, status

from pcretrieve import serve
from pcretrieve.errors import InputError

PRIVATE = ("/", "/shapes", "/shapes/Egg00/similar", "/assets/page.css", "/nothing")


def test_nothing_is_answered_without_the_token(server: Server) -> None:
    right, cookie = server.token, f"pcretrieve-{server.port}"
    near = [
        right[:-1],
        right + "x",
        right[:-1] + chr(ord(right[-1]) ^ 1),
        right.swapcase(),
        "",
        "x" * 9000,
    ]
    sent = [{}, {"Authorization": "Bearer é"}, {"Authorization": f"Basic {right}"}]
    for token in near:
        sent += [{"Authorization": f"Bearer {token}"}, {"Cookie": f"{cookie}={token}"}]
    answers = [
        server.ask(path, headers=one, bearer=False) for path in PRIVATE for one in sent
    ]
    answers += [
        server.ask(f"{path}?token={token}", bearer=False)
        for path in PRIVATE
        for token in near
    ]
    assert {(answer.status, answer.body) for answer in answers} == {
        (403, answers[0].body)
    }
    assert {answer.headers["connection"] for answer in answers} == {"close"}


def test_the_address_gives_the_browser_a_cookie(server: Server) -> None:
    answer = server.ask(f"/shape/Egg00?k=2&token={server.token}", bearer=False)
    assert (answer.status, answer.headers["location"]) == (303, "/shape/Egg00?k=2")
    value, *attributes = answer.headers["set-cookie"].split("; ")
    assert {"HttpOnly", "SameSite=Strict", "Path=/"} == set(attributes)
    again = server.ask("/shape/Egg00?k=2", headers={"Cookie": value}, bearer=False)
    assert again.status == 200
    assert server.token.encode() not in again.body
    for path in ("//evil.example/", "/\\evil.example/", "///evil.example"):
        location = server.ask(f"{path}?token={server.token}", bearer=False).headers[
            "location"
        ]
        assert location.startswith("/") and location[1] not in "/\\"


def test_addresses_and_cookies_of_others_change_no_cookie_and_lock_nobody_out(
    server: Server,
) -> None:
    name = f"pcretrieve-{server.port}"
    own = f"{name}={server.token}"
    for given in ("x%0d%0aX-Evil:%201", "%E2%82%AC", "x;%20Path=/shape", "wrong", ""):
        answer = server.ask(f"/?token={given}", headers={"Cookie": own}, bearer=False)
        assert (answer.status, answer.headers["location"]) == (303, "/")
        assert answer.headers["set-cookie"] == f"{own}; Path=/; HttpOnly; SameSite=Strict"
        assert "x-evil" not in answer.headers
    for cookies in (
        'a={"b": [1, 2]}; OWN',
        "OWN; a=[;]",
        f"{name}=evil; OWN",
        ";;=;OWN; é",
    ):
        sent = {"Cookie": cookies.replace("OWN", own)}
        assert server.ask("/", headers=sent, bearer=False).status == 200


def test_hosts_and_origins_are_of_this_computer_alone(server: Server) -> None:
    for host in (
        *(
            "evil.example",
            "127.0.0.1.evil.example",
            "127.0.0.1@evil.example",
            "127.0.0.1.nip.io",
            "",
            "[",
        ),
        *("2130706433", "0.0.0.0", "169.254.1.1:80"),
    ):
        for claim in (
            {},
            {"X-Forwarded-Host": "127.0.0.1"},
            {"Origin": "http://127.0.0.1"},
        ):
            assert server.ask("/", headers={"Host": host, **claim}).status == 400
    assert (
        status(raw(server, "GET / HTTP/1.1\r\nHost: evil.example\r\nKNOWN\r\n\r\n"))
        == 400
    )
    for host in ("localhost:8000", "127.0.0.1", "[::1]:9"):
        assert server.ask("/", headers={"Host": host}).status == 200
    for origin in ("http://evil.example", "null", "http://127.0.0.1:1", "file://"):
        assert server.ask("/shapes", headers={"Origin": origin}).status == 403
    own = {"Origin": f"http://127.0.0.1:{server.port}"}
    assert server.ask("/shapes", headers=own).status == 200


def test_pages_may_use_this_server_alone(server: Server) -> None:
    for path in (*PRIVATE, "/shapes/none"):
        headers = server.ask(path).headers
        policy = headers["content-security-policy"]
        assert "default-src 'none'" in policy and "unsafe" not in policy
        assert "font-src data:;" in policy
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "same-origin"
        assert "server" not in headers
        assert headers["server-timing"].startswith("total;dur=")


def test_other_methods_are_refused(server: Server) -> None:
    own = {"Cookie": f"pcretrieve-{server.port}={server.token}"}
    for method in ("POST", "PUT", "DELETE", "OPTIONS", "TRACE"):
        assert server.ask("/shapes/Egg00", method=method).status == 405
        assert server.ask("/", method=method, headers=own, bearer=False).status == 403
    for method in ("post", "Get", "CONNECT", "PATCH", "GETX"):
        assert (
            server.ask("/shapes", method=method, headers=own, bearer=False).status == 403
        )
    for path in ("/scans?name=a.off", f"/scans?name=a.off&token={server.token}"):
        for origin in ({}, {"Origin": "http://evil.example"}, {"Origin": "null"}):
            sent = {**own, **origin}
            assert (
                server.ask(
                    path, method="POST", body=b"OFF", headers=sent, bearer=False
                ).status
                == 403
            )
    upgrade = {
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Version": "13",
    }
    assert (
        server.ask(
            "/", headers={**upgrade, "Sec-WebSocket-Key": 16 * "x"}, bearer=False
        ).status
        == 403
    )


@pytest.mark.slow
def test_each_server_has_a_token_of_its_own(server: Server, eggs: Path) -> None:
    with running(eggs, "--whitening", "pca") as other:
        assert other.token != server.token
        assert "pca" in other.ask("/shapes/Egg00/similar").json["whitening"]


def test_a_server_listens_at_this_computer_only_and_says_what_it_cannot_do(
    server: Server, eggs: Path
) -> None:
    assert server.address.startswith("http://127.0.0.1:") and len(server.token) >= 32
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.2", server.port), timeout=9)
    with pytest.raises(
        InputError, match=f"cannot serve at port {server.port}: .* give another --port"
    ):
        serve(eggs, port=server.port)
    for token in ("a b", "a;b", "a\nb", "é", "a/b"):
        with pytest.raises(InputError, match="the token must be ASCII letters"):
            serve(eggs, token=token, port=0)
