"""The server of the search page, by uvicorn."""

from __future__ import annotations

import re
import secrets
import socket
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from pcretrieve import Catalogue, PipelineOptions, index
from pcretrieve.errors import InputError
from pcretrieve.ingestion.pool import own_limit
from pcretrieve.options import OptionsLike

if TYPE_CHECKING:
    from pcretrieve.web.application import Site
    from pcretrieve.web.guard import Guard

ADDRESS = "127.0.0.1"

TOKEN = re.compile(r"[A-Za-z0-9_-]+")

# Number of threads that draw pictures. Searches have one thread of their own, and lists too: Python runs one
# thread at a time, and of 50 queries at a time at 100,000 shapes, one thread answers 443 a second, two
# threads 355 and three 332 (two cores), because they wait for each other.
N_DRAWING = 2

# Largest number of connections at a time, the longest time for which an idle one is kept, and the longest
# time until the first request of a connection has arrived, without its body; seconds.
MOST_CONNECTIONS = 200
KEEP_ALIVE = 5
FIRST_REQUEST = 10

# Largest memory of the process of a scan by default; GiB.
MEMORY = 4.0


def serve(
    catalogue: str | Path,
    *,
    options: OptionsLike = None,
    port: int = 8765,
    token: str | None = None,
    read_only: bool = False,
    most_bytes: int = 200_000_000,
    timeout: float = 300.0,
    memory: float | None = None,
    up: str | None = None,
    keep: str | Path | None = None,
    export: str | Path | None = None,
    on_start: Callable[[str], None] = lambda address: None,
) -> None:
    """Serve the search page of a catalogue to browsers of this computer, until Ctrl-C or SIGTERM.

    Parameters
    ----------
    catalogue : str or Path
        The path or the URL of the catalogue.
    options : OptionsLike, optional
        Signature, distance and whitening. By default the options of the catalogue.
    port : int, default 8765
        The port, at 127.0.0.1; 0 for any that is free.
    token : str, optional
        The token that requests must have; by default a new random one.
    read_only : bool, default False
        Whether no scans can be uploaded.
    most_bytes : int, default 200 million
        Largest size of an uploaded scan.
    timeout : float, default 300
        Longest time to process an uploaded scan; seconds.
    memory : float, optional
        Largest heap of the process that processes uploaded scans; GiB. By default 4, where the system has
        such a limit.
    up : {"x", "-x", "y", "-y", "z", "-z"}, optional
        The axis of the files that points upwards, for the pictures of all shapes. By default it is found for
        each: by the ground that was removed from its scan, or from the surface.
    keep : str or Path, optional
        A folder, in which uploaded scans are stored if that is asked for, as shapes of the catalogue. By
        default none can be kept.
    export : str or Path, optional
        A new or empty folder, to which the pages are written instead: a site that can be mailed, or put on a
        web server, with relative links and without uploads.
    on_start : function, optional
        Called with the address that contains the token, as soon as the server accepts connections.

    Raises
    ------
    InputError
        If the token has other characters than letters, digits, ``-`` and ``_``, `keep` is no folder, the port
        is used by another program, or the catalogue has no shapes that can be compared.
    OptionError
        If `up` is no axis.
    CatalogueError
        If the catalogue cannot be opened, or the options require other spectra than it has.
    """
    # Imported here, because the server alone needs the web framework.
    from pcretrieve.web.application import application
    from pcretrieve.web.guard import Guard

    key = token or secrets.token_urlsafe(24)
    if not TOKEN.fullmatch(key):
        raise InputError(
            "the token must be ASCII letters, digits, - and _ only, as it is part of an address"
        )
    read_only |= export is not None
    if keep is not None and (read_only or not Path(keep).is_dir()):
        raise InputError(
            f"scans are kept in a folder, by a server that is not read-only, got {keep}"
        )
    with opened_site(
        catalogue,
        options,
        read_only=read_only,
        most_bytes=most_bytes,
        timeout=timeout,
        memory=memory or own_limit(MEMORY),
        up=up,
        keep=keep,
    ) as site:
        if export is not None:
            from pcretrieve.web.export import export_site

            export_site(replace(site, exported=True), str(catalogue), Path(export))
            return
        with _listening(port) as listener:
            address = f"http://{ADDRESS}:{listener.getsockname()[1]}/?token={key}"
            site.searching.prepare(
                lambda catalogue: index(catalogue, options=site.options).load()
            )
            _run(Guard(application(site), key), listener, lambda: on_start(address))


@contextmanager
def opened_site(
    catalogue: str | Path,
    options: OptionsLike = None,
    *,
    read_only: bool,
    most_bytes: int,
    timeout: float,
    memory: float | None,
    up: str | None,
    keep: str | Path | None,
) -> Iterator[Site]:
    """Open a catalogue and all that requests need; the arguments are those of `serve`."""
    from pcretrieve.pages.thumbnails import Thumbnails
    from pcretrieve.web.application import Readers, Site
    from pcretrieve.web.comparison import Maps
    from pcretrieve.web.jobs import Jobs
    from pcretrieve.web.keeping import Collection

    with Catalogue(catalogue) as store:
        chosen = PipelineOptions.of(options, store.options)
        # Made now, so that what it lacks is said before the first request; failures have pages without one.
        if len(store) or not store.rows.failures():
            index(store, options=chosen)
        title, thumbnails = Path(store.location).stem, Thumbnails(store, up)
        scanned = store.options.model_copy(update={"signature": chosen.signature})
    location = str(catalogue)
    jobs = collection = None
    if keep is not None:
        collection = Collection(location, Path(keep).absolute(), timeout, memory)
    if not read_only:
        jobs = Jobs(
            location,
            title,
            scanned,
            timeout=timeout,
            memory=memory,
            thumbnails=thumbnails,
            collection=collection,
        )
    with closing(
        Site(
            searching=Readers(location, 1),
            listing=Readers(location, 1),
            drawing=Readers(location, N_DRAWING),
            title=title,
            options=chosen,
            given_jobs=jobs,
            most_bytes=most_bytes,
            thumbnails=thumbnails,
            maps=Maps(location, chosen),
        )
    ) as site:
        yield site


def _listening(port: int) -> socket.socket:
    # With the protocol said, because asyncio sends small answers at once (TCP_NODELAY) only then.
    listener = socket.socket(proto=socket.IPPROTO_TCP)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((ADDRESS, port))
        listener.listen(128)
    except (OSError, OverflowError) as error:
        listener.close()
        raise InputError(
            f"cannot serve at port {port}: {error}; give another --port, or 0"
        ) from error
    return listener


def _run(guarded: Guard, listener: socket.socket, on_start: Callable[[], None]) -> None:
    import asyncio

    import uvicorn
    from uvicorn.protocols.http.h11_impl import H11Protocol

    class Connection(H11Protocol):
        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            super().connection_made(transport)
            self.loop.call_later(FIRST_REQUEST, self._close_unless_used)

        def _close_unless_used(self) -> None:
            if self.cycle is None:
                self.transport.close()

    config = uvicorn.Config(
        guarded,
        http=Connection,
        ws="none",
        proxy_headers=False,
        log_config=None,
        access_log=False,  # addresses may contain the token
        server_header=False,
        limit_concurrency=MOST_CONNECTIONS,
        timeout_keep_alive=KEEP_ALIVE,
        timeout_graceful_shutdown=KEEP_ALIVE,
        lifespan="off",
    )
    server = uvicorn.Server(config)

    async def run() -> None:
        serving = asyncio.ensure_future(server.serve(sockets=[listener]))
        while not (server.started or serving.done()):
            await asyncio.sleep(0.01)
        if not serving.done():
            on_start()
        await serving

    asyncio.run(run())
