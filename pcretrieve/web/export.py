"""A catalogue as a site of files, whose pages have relative links and need no server."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from html import unescape
from pathlib import Path
from urllib.parse import quote

from starlette.requests import Request
from starlette.responses import Response

from pcretrieve import Catalogue, pages
from pcretrieve.errors import InputError
from pcretrieve.values.files import write_file
from pcretrieve.web.application import LISTS, OTHERS, SEARCHES, Asked, Site
from pcretrieve.web.comparison import map_of
from pcretrieve.web.requests import Refused

# What the pages of an exported site load.
ASSETS = {"page.css", "search.css", "map.css", "find.js", "map.js"}

LINK = re.compile(r'(href|src|data-picture)="/([^"]*)"')


def export_site(site: Site, location: str, folder: Path) -> None:
    """Write the pages of a catalogue to a folder that is new or empty.

    They are the collection on one page, each shape with its nearest ones, and the map. Files of shapes have
    numbers, because not every id is the name of a file.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"a site is exported to a new or an empty folder, got {folder}")
    with Catalogue(location) as store:
        _, ids = store.rows.wanted()
        places = {"": "index.html", "map": "map.html"}
        for number, address in enumerate(quote(one, safe="") for one in ids):
            places[f"shape/{address}"] = f"shapes/{number}.html"
            places[f"shapes/{address}/thumbnail.png"] = f"pictures/{number}.png"

        def answered(answer: Callable[[Asked], Response], shape_id: str = "") -> bytes:
            path = {"id": quote(shape_id, safe="")}
            scope = {
                "type": "http",
                "query_string": b"",
                "headers": [],
                "path_params": path,
            }
            return bytes(answer(Asked(site, store, Request(scope), 0.0)).body)

        def linked(page: bytes, up: str = "") -> bytes:
            # Styles and scripts have the same places on the server.
            return LINK.sub(
                lambda link: f'{link[1]}="{up}{places.get(unescape(link[2]), link[2])}"',
                page.decode(),
            ).encode()

        shutil.copytree(
            Path(pages.__path__[0], "assets"),
            folder / "assets",
            ignore=lambda _, names: {*names} - ASSETS,
        )
        for part in ("shapes", "pictures"):
            (folder / part).mkdir()
        for number, one in enumerate(ids):
            page = linked(answered(SEARCHES["/shape/{id}"], one), "../")
            write_file(folder / "shapes" / f"{number}.html", page)
            try:
                picture = answered(OTHERS["/shapes/{id}/thumbnail.png"], one)
            except Refused:  # failed
                continue
            write_file(folder / "pictures" / f"{number}.png", picture)
        drawn = map_of(site.options, location) if len(store) else {"drawing": None}
        page = answered(lambda asked: asked.page("search_map.html", **drawn))
        write_file(folder / "map.html", linked(page))
        # Last, so that a site with a first page is complete.
        write_file(folder / "index.html", linked(answered(LISTS["/"])))
