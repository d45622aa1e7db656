"""Messages without the names of folders, which are nobody's business but the server's."""

from __future__ import annotations

import re
from pathlib import Path
from tempfile import gettempdir

__all__ = ["without_folders"]


def without_folders(text: str, folder: Path | None = None) -> str:
    """A message without the folders of absolute paths in it: of ``/data/scans/a.ply`` the name remains."""
    for known in (folder, Path(gettempdir())):
        if known is not None and known.name:
            text = text.replace(f"{known}/", "/")
    return re.sub(r"(?<![\w./])(?:/[^/\s'\"]+)*/(?=[^/\s])", "", text)
