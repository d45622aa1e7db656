"""Paths of URLs.

Scans are named by paths everywhere, and a `Path` keeps one of the two slashes after the protocol of a URL:
that of ``s3://bucket/a.ply`` is ``s3:/bucket/a.ply``.
"""

from __future__ import annotations

import re
from pathlib import Path

__all__ = ["url_of"]

# A protocol has two letters at least, unlike the drives of Windows.
PROTOCOL = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+):(/.*)", re.DOTALL)

# Protocols of file systems whose paths are absolute.
LOCAL = frozenset({"file", "local"})


def url_of(path: Path) -> str | None:
    """The URL that a path was made of."""
    found = PROTOCOL.fullmatch(str(path))
    if found is None:
        return None
    protocol, rest = found.groups()
    return f"{protocol}:/{'/' if protocol in LOCAL else ''}{rest}"
