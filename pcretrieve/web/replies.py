"""Answers, before they are sent: content, media type, and how long a browser may keep them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, NamedTuple

__all__ = ["FRESH", "KEPT", "Reply", "csv_reply", "html_reply", "json_reply"]

#: Answers that belong to one state of the catalogue are asked for again each time, pictures once in an hour.
FRESH = {"cache-control": "private, no-cache"}
KEPT = {"cache-control": "private, max-age=3600"}


class Reply(NamedTuple):
    """What is sent to a browser."""

    content: str | bytes
    media_type: str
    headers: Mapping[str, str] = FRESH


def html_reply(page: str) -> Reply:
    """A page, which is asked for again each time."""
    return Reply(_encoded(page), "text/html")


def json_reply(document: dict[str, Any]) -> Reply:
    """A JSON document, which is asked for again each time."""
    return Reply(json.dumps(document, separators=(",", ":")), "application/json")


def csv_reply(table: str) -> Reply:
    """A table, which browsers store as a file."""
    headers = FRESH | {"content-disposition": 'attachment; filename="similar.csv"'}
    return Reply(_encoded(table), "text/csv", headers)


def _encoded(text: str) -> bytes:
    """A text as UTF-8; bytes of file names that are not UTF-8 are replaced by question marks."""
    return text.encode("utf-8", errors="replace")
