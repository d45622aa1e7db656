"""Templates → pages, and numbers → what templates draw of them."""

from __future__ import annotations

import re
from base64 import b64encode
from functools import cache
from pathlib import Path
from tempfile import gettempdir
from urllib.parse import quote

from jinja2 import Environment, PackageLoader, StrictUndefined

from pcretrieve.draw.pictures import rgb
from pcretrieve.values.files import write_file


def page_of(template: str, **context: object) -> bytes:
    """A page by a template, which may include files of the folder ``assets``."""
    page = _environment().get_template(f"templates/{template}").render(context)
    # Bytes of file names that are not UTF-8 are replaced by question marks.
    return page.encode("utf-8", errors="replace")


def write_page(path: str | Path, template: str, **context: object) -> Path:
    """Write a page. An existing file is replaced in one step, or left unchanged."""
    target = Path(path).absolute()
    write_file(target, page_of(template, **context))
    return target


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("pcretrieve.pages", ""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "three_digits": _three_digits,
        "base64": encoded,
        "without_folders": without_folders,
        "css": lambda colour: "#" + bytes(rgb(colour)).hex(),
        # A name as one part of an address; slashes in it too are escaped.
        "in_address": lambda name: quote(name, safe=""),
    }
    environment.globals["counted"] = lambda n, one, many: f"{n} {one if n == 1 else many}"
    return environment


def _three_digits(value: float) -> str:
    """A number with three significant digits; as an integer, if it is at least 1000."""
    text = f"{value:#.3g}".rstrip(".")
    return f"{float(text):.0f}" if "e+" in text else text


def encoded(content: bytes) -> str:
    """Bytes as base64."""
    return b64encode(content).decode("ascii")


def without_folders(text: str, folder: Path | None = None) -> str:
    """A message without the folders of absolute paths in it: of ``/data/scans/a.ply`` the name remains.

    The folders of this computer are nobody's business.
    """
    for known in (folder, Path(gettempdir())):
        if known is not None and known.name:
            text = text.replace(f"{known}/", "/")
    return re.sub(r"(?<![\w./])(?:/[^/\s'\"]+)*/(?=[^/\s])", "", text)
