"""The OpenAPI document says what the server does."""

from __future__ import annotations

from urllib.parse import quote

import pytest
from search_server import NASTY, Server

from pcretrieve.web.endpoints import ENDPOINTS
from pcretrieve.web.openapi import openapi_document

# What must be in an address for an answer that is no error.
GIVEN = {"/compare": "?a=Egg00&b=Egg01"}


def test_every_address_is_described_and_answers_as_described(server: Server) -> None:
    document = server.ask("/openapi.json").json
    assert document == openapi_document()
    described = {path for path, operations in document["paths"].items() if "get" in operations}
    assert described >= {endpoint.path for endpoint in ENDPOINTS}
    for path in sorted(path for path in described if not path.startswith("/scan")):
        answer = server.ask(path.replace("{id}", quote(NASTY, safe="")) + GIVEN.get(path, ""))
        assert answer.status == 200, path
        (media_type,) = document["paths"][path]["get"]["responses"]["200"]["content"]
        assert answer.headers["content-type"].startswith(media_type), path


def test_described_fields_are_read(server: Server) -> None:
    """Each field is given a value that it cannot have; only names and words may have any."""
    paths = server.ask("/openapi.json").json["paths"]
    for path in ("/shapes", "/shapes/{id}/similar"):
        for field in paths[path]["get"]["parameters"]:
            if field["in"] == "query" and field["name"] not in ("q", "label"):
                answer = server.ask(f"{path.replace('{id}', 'Egg00')}?{field['name']}=%3F")
                assert answer.status == 400, (path, field["name"])
                assert field["name"] in answer.json["message"]


@pytest.mark.parametrize(
    "path", ["/shapes/none", "/shapes/none/scene", "/shapes/none/mesh.glb", "/scans/none"]
)
def test_errors_are_as_described(server: Server, path: str) -> None:
    answer = server.ask(path)
    assert answer.status == 404
    assert set(answer.json) == {"error", "message"}


def test_shapes_without_a_signature_are_not_compared(server: Server) -> None:
    assert b"cannot be compared" in server.ask("/compare?a=Egg00&b=broken").body
    assert server.ask("/compare?a=Egg00").status == 404
