"""The OpenAPI 3.1 document of the server, from the table of its addresses."""

from __future__ import annotations

from typing import Any

from pcretrieve import __version__
from pcretrieve.web.endpoints import ENDPOINTS, KEPT_AS, Field

__all__ = ["openapi_document"]

# Answers that are no documents of JSON schema have a type only; errors are one document for all.
ERROR = {
    "type": "object",
    "required": ["error", "message"],
    "properties": {
        "error": {"type": "string", "description": "kind of error"},
        "message": {"type": "string", "description": "what does not hold, and what to do"},
    },
}
ERRORS = {
    "400": "a value that cannot be",
    "403": "the token is missing or wrong",
    "404": "there is no shape or scan of this name",
}


# Addresses that are not answered from the catalogue.
OTHERS: list[tuple[str, str, str, tuple[Field, ...]]] = [
    (
        "/scans/{id}/events",
        "the document of /scans/{id} at each change, as server-sent events",
        "text/event-stream",
        (),
    ),
    ("/openapi.json", "this document", "application/json", ()),
]


def openapi_document() -> dict[str, Any]:
    """Describe the addresses for scripts, and for the generators of their clients."""
    operations = [(it.path, it.words, it.media_type, it.fields) for it in ENDPOINTS]
    paths: dict[str, Any] = {
        path: {"get": _operation(path, words, media_type, fields)}
        for path, words, media_type, fields in [*operations, *OTHERS]
    }
    paths["/scans"] = {"post": _upload()}
    paths["/scans/{id}/keep"] = {"post": _keeping()}
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "pcretrieve",
            "version": __version__,
            "description": "The shapes of a catalogue, and the nearest of them to a shape or a scan.",
        },
        "paths": paths,
        "components": {
            "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}},
            "schemas": {"Error": ERROR},
        },
        "security": [{"token": []}],
    }


def _operation(path: str, words: str, media_type: str, fields: tuple[Field, ...]) -> dict[str, Any]:
    in_path = [Field("id", "the name, percent-encoded", required=True)] if "{id}" in path else []
    parameters = [_parameter(field, "path") for field in in_path]
    parameters += [_parameter(field, "query") for field in fields]
    schema = {"type": "object"} if media_type == "application/json" else {}
    answer = {"description": words, "content": {media_type: {"schema": schema}}}
    return {"summary": words, "parameters": parameters, "responses": {"200": answer} | _errors(ERRORS)}


def _upload() -> dict[str, Any]:
    name = Field("name", "name of its file, whose suffix says its format", required=True)
    more = {"408": "it arrives too slowly", "413": "it is too large", "503": "too many scans wait"}
    accepted = {
        "description": "the scan waits; the header Location is the address of its job",
        "content": {"application/json": {"schema": {"type": "object"}}},
    }
    return {
        "summary": "upload a scan, which is processed, inspected, and removed unless it is kept",
        "parameters": [_parameter(name, "query")],
        "requestBody": {
            "required": True,
            "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
        },
        "responses": {"202": accepted} | _errors(ERRORS | more),
    }


def _keeping() -> dict[str, Any]:
    stored = {
        "description": "what the catalogue says of the shape; the header Location is its address",
        "content": {"application/json": {"schema": {"type": "object"}}},
    }
    return {
        "summary": "keep an uploaded scan as a shape of the catalogue, if the server was started with --keep",
        "parameters": [
            _parameter(Field("id", "the job of the scan", required=True), "path"),
            *(_parameter(field, "query") for field in KEPT_AS),
        ],
        "responses": {"201": stored} | _errors(ERRORS),
    }


def _errors(words: dict[str, str]) -> dict[str, Any]:
    content = {"application/json": {"schema": {"$ref": "#/components/schemas/Error"}}}
    return {status: {"description": text, "content": content} for status, text in words.items()}


def _parameter(field: Field, place: str) -> dict[str, Any]:
    schema: dict[str, Any] = {"type": field.type}
    if field.choices:
        schema["enum"] = list(field.choices)
    return {
        "name": field.name,
        "in": place,
        "description": field.words,
        "required": field.required,
        "schema": schema,
    }
