"""Atomic writing: at any time a file is complete, as it was before or as it is afterwards."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

__all__ = ["replace_file"]


def replace_file(path: Path, data: bytes) -> None:
    """Write a temporary file in the same directory, and rename it.

    Parameters
    ----------
    path : Path
        The file. An existing file is replaced, and keeps its content if the writing fails.
    data : bytes
        The new content.
    """
    descriptor, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    beside = Path(name)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
        mask = os.umask(0)
        os.umask(mask)
        beside.chmod(0o666 & ~mask)  # the usual permissions; mkstemp makes private files
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)
