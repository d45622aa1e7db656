"""HTML templates of the pages, with their style sheets and scripts inlined."""

from __future__ import annotations

from base64 import b64encode
from functools import cache

from jinja2 import Environment, PackageLoader, StrictUndefined, Template

__all__ = ["page_template"]


@cache
def page_template(name: str) -> Template:
    """A template of the folder ``templates``, which may include files of the folder ``assets``.

    Parameters
    ----------
    name : str
        Such as ``report.html``.

    Returns
    -------
    jinja2.Template
        With the filters ``three_digits`` and ``data_uri``; everything that is filled in is escaped.
    """
    environment = Environment(
        loader=PackageLoader("pcretrieve.pages", ""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["three_digits"] = _three_digits
    environment.filters["data_uri"] = _data_uri
    return environment.get_template(f"templates/{name}")


def _three_digits(value: float) -> str:
    """Three significant digits; whole numbers from 1000 on."""
    text = f"{value:#.3g}".rstrip(".")
    return f"{float(text):.0f}" if "e+" in text else text


def _data_uri(picture: bytes) -> str:
    return "data:image/png;base64," + b64encode(picture).decode("ascii")
