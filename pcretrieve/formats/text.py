"""Text files: their lines."""

from __future__ import annotations

from pathlib import Path

from pcretrieve.formats.text_layout import no_text

__all__ = ["text_lines"]


def text_lines(path: Path) -> list[str]:
    """The lines of a text file."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise no_text(path) from error
    if "\0" in text:
        raise no_text(path)
    return text.splitlines()
