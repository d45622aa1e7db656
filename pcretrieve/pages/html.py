"""HTML templates of the pages, with their style sheets and scripts inlined."""

from __future__ import annotations

from base64 import b64encode
from functools import cache
from urllib.parse import quote

from jinja2 import Environment, PackageLoader, StrictUndefined, Template

__all__ = ["page_template"]


@cache
def page_template(name: str) -> Template:
    """Load a template from the folder ``templates``, which may include files of the folder ``assets``."""
    environment = Environment(
        loader=PackageLoader("pcretrieve.pages", ""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["three_digits"] = _three_digits
    environment.filters["data_uri"] = _data_uri
    environment.filters["in_address"] = _in_address
    return environment.get_template(f"templates/{name}")


def _three_digits(value: float) -> str:
    """A number with three significant digits; as an integer, if it is at least 1000."""
    text = f"{value:#.3g}".rstrip(".")
    return f"{float(text):.0f}" if "e+" in text else text


def _data_uri(picture: bytes) -> str:
    return "data:image/png;base64," + b64encode(picture).decode("ascii")


def _in_address(name: str) -> str:
    """A name as one part of an address; slashes in it too are escaped."""
    return quote(name, safe="")
