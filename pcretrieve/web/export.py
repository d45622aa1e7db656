"""A catalogue as a site of files, whose pages have relative links and need no server."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from html import unescape
from pathlib import Path
from typing import Any
from urllib.parse import quote

from pcretrieve import Catalogue, pages
from pcretrieve.errors import InputError
from pcretrieve.values.files import write_file
from pcretrieve.web.application import LISTS, SEARCHES, Asked, Site
from pcretrieve.web.comparison import map_of

# What the pages of an exported site load.
ASSETS = {"typeface.css", "page.css", "search.css", "map.css", "find.js", "map.js"}

LINK = re.compile(r'(href|src|data-picture)="/([^"]*)"')


def export_site(site: Site, location: str, folder: Path) -> None:
    """Write the pages of a catalogue to a folder that is new or empty.

    They are the collection on one page, each shape with its nearest ones, and the map. Files of shapes have
    numbers, because not every id is the name of a file.
    """
    from starlette.requests import Request

    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"a site is exported to a new or an empty folder, got {folder}")
    with Catalogue(location) as store:
        _, ids = store.rows.wanted()
        places = {"": "index.html", "map": "map.html"}
        for number, address in enumerate(quote(one, safe="") for one in ids):
            places[f"shape/{address}"] = f"shapes/{number}.html"
            places[f"shapes/{address}/thumbnail.png"] = f"pictures/{number}.png"

        def write(place: str, answer: Callable[[Asked], Any], shape_id: str = "") -> None:
            path = {"id": quote(shape_id, safe="")}
            scope = {"type": "http", "query_string": b"", "path_params": path}
            page = bytes(answer(Asked(site, store, Request(scope), 0.0)).body)
            up = "../" * place.count("/")
            # Styles and scripts have the same places on the server.
            linked = LINK.sub(
                lambda link: f'{link[1]}="{up}{places.get(unescape(link[2]), link[2])}"',
                page.decode(),
            )
            write_file(folder / place, linked.encode())

        shutil.copytree(
            Path(pages.__path__[0], "assets"),
            folder / "assets",
            ignore=lambda _, names: {*names} - ASSETS,
        )
        for part in ("shapes", "pictures"):
            (folder / part).mkdir()
        for number, one in enumerate(ids):
            write(f"shapes/{number}.html", SEARCHES["/shape/{id}"], one)
            picture = site.thumbnails.of(store, store.record(one))
            if picture is not None:  # or it failed
                write_file(folder / "pictures" / f"{number}.png", picture)
        drawn = map_of(site.options, location) if len(store) else {"drawing": None}
        write("map.html", lambda asked: asked.page("search_map.html", **drawn))
        # Last, so that a site with a first page is complete.
        write("index.html", LISTS["/"])
