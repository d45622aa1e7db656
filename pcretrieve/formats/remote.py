"""Scans at URLs, by fsspec: what the URLs name, and copies of the files on this computer."""

from __future__ import annotations

import socket
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from ipaddress import ip_address
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from pcretrieve.errors import InputError, PcretrieveError, ScanReadError, ShapeError
from pcretrieve.formats.registry import ScanPath, parts_of

# Largest size of a file that is copied for one command; bytes.
LARGEST = 1 << 32

# What stores say of the content of a file, the best first: hashes, then the time of the last change.
VERSIONS = (
    "ETag",
    "etag",
    "md5Hash",
    "Content-MD5",
    "Digest",
    "crc32c",
    "checksum",
    "LastModified",
    "Last-Modified",
    "updated",
    "mtime",
    "created",
)

# Largest size of all pages of a listing together: some 70,000 files; bytes.
MOST_LISTED_BYTES = 1 << 24
# Largest number of files of a listing, which stores give without pages.
MOST_LISTED = 200_000

# Protocols of URLs. For others, fsspec would load code that nobody has checked, and connect anywhere.
PROTOCOLS = ("http", "https", "s3", "file")


def remote_files(url: str) -> list[ScanPath]:
    """The files that a URL names: by a pattern, in a folder and below, or one."""
    with _store(url, InputError, "look into") as (system, place):
        if any(sign in place for sign in "*?["):
            found = [name for name in system.glob(place) if system.isfile(name)]
        elif system.isdir(place):
            found = system.find(place)
        else:
            found = [place] if system.exists(place) else []
        if len(found) > MOST_LISTED:
            raise ScanReadError(_too_long(MOST_LISTED, "names"))
        return [
            ScanPath.parse(str(system.unstrip_protocol(name))) for name in sorted(found)
        ]


def remote_version(url: str) -> str | None:
    """What the store says of the content of a file, without reading it."""
    with _store(url) as (system, place):
        about = system.info(place)
    known = next((key for key in VERSIONS if about.get(key)), None)
    # Some servers compute what they call a hash from the size and the time of the last change.
    return None if known is None else f"{url} {known} {about[known]} {about.get('size')}"


@contextmanager
def local_copy(scan: ScanPath) -> Iterator[ScanPath]:
    """A scan on this computer with the same content."""
    if scan.url is None:
        yield scan
        return
    above = scan.url.rpartition("/")[0]
    with TemporaryDirectory(prefix="pcretrieve-") as folder:
        file = Path(folder, scan.file.name)
        _copy(scan.url, file)
        for part in parts_of(file):
            # A file may name files anywhere: only those beside it and below belong to the scan.
            if part.path.is_relative_to(folder) and ".." not in part.path.parts:
                part.path.parent.mkdir(parents=True, exist_ok=True)
                _copy(f"{above}/{part.path.relative_to(folder)}", part.path)
        try:
            yield ScanPath(file, scan.member)
        except ShapeError as error:
            error.message = error.message.replace(folder, above)
            raise


def _copy(url: str, file: Path) -> None:
    with _store(url) as (system, place):
        from fsspec.callbacks import Callback

        def check(size: int | None, value: int) -> None:
            if max(size or 0, value) > LARGEST:
                raise ScanReadError(
                    f"{url} has more than {LARGEST} bytes: copy it to this computer first"
                )

        system.get_file(place, str(file), callback=Callback(hooks={"size": check}))


@contextmanager
def _store(
    url: str, kind: type[PcretrieveError] = ScanReadError, act: str = "read"
) -> Iterator[tuple[Any, str]]:
    """The file system of a URL, and the path in it. Errors of stores get one kind and a message."""
    protocol = url.partition(":")[0]
    if protocol not in PROTOCOLS:
        raise kind(
            f"a URL must begin with {', '.join(PROTOCOLS)}, got {url}: copy the scan to this computer first"
        )
    try:
        try:
            from fsspec.core import url_to_fs

            own: dict[str, Any] = {}
            if protocol in ("http", "https"):
                own = {"get_client": _client, "skip_instance_cache": True}
            system, place = url_to_fs(url, **own)
        except ImportError as error:
            raise kind(
                f"cannot {act} {url}, {error}: pip install 'pcretrieve[remote]'"
            ) from error
        yield system, place
    except PcretrieveError:
        raise
    # Stores have exceptions of many packages, which are not all an OSError.
    except Exception as error:
        words = getattr(error, "strerror", None) or error or type(error).__name__
        if isinstance(error, FileNotFoundError):
            refused = isinstance(error.__cause__, PcretrieveError)
            words = error.__cause__ if refused else "there is no such file"
        raise kind(f"cannot {act} {url}: {words}") from error


# --- HTTP -----------------------------------------------------------------------------------------------


async def _client(**settings: Any) -> Any:
    """A client for one request or one listing, which checks addresses, and the size of all pages together."""
    import aiohttp
    from yarl import URL

    n_bytes = 0
    is_redirected = False

    class Page(aiohttp.ClientResponse):
        """A response that is read as text only if it is a page of a listing."""

        async def text(self, encoding: str | None = None, errors: str = "strict") -> str:
            nonlocal n_bytes
            page = bytearray()
            async for chunk in self.content.iter_any():
                page += chunk
                n_bytes += len(chunk)
                if n_bytes > MOST_LISTED_BYTES:
                    raise ScanReadError(_too_long(MOST_LISTED_BYTES, "bytes"))
            return page.decode(encoding or "utf-8", errors)

    async def redirected(session: object, context: object, request: Any) -> None:
        nonlocal is_redirected
        headers = request.response.headers
        target = URL(headers.get("Location") or headers.get("URI", ""))
        is_redirected |= request.url.join(target).host != request.url.host

    def checked_socket(info: Any) -> socket.socket:
        # From here on, neither a name nor a redirect can lead to another address.
        family, kind, protocol, _, address = info
        _check_address(address, is_redirected)
        return socket.socket(family, kind, protocol)

    steps = aiohttp.TraceConfig()
    steps.on_request_redirect.append(redirected)
    settings["connector"] = aiohttp.TCPConnector(socket_factory=checked_socket)
    return aiohttp.ClientSession(response_class=Page, trace_configs=[steps], **settings)


def _too_long(most: int, what: str) -> str:
    return f"a listing must have at most {most} {what}, this one has more: name a folder below it"


def _check_address(address: Sequence[Any], is_redirected: bool = False) -> None:
    """Refuse link-local addresses, at which clouds give away passwords, and redirects into own networks."""
    ip = ip_address(address[0])
    ip = getattr(ip, "ipv4_mapped", None) or ip
    if ip.is_link_local or (is_redirected and not ip.is_global):
        raise ScanReadError(
            f"a URL must not lead to the address {ip}, which is link-local or, by a redirect from another "
            "host, in a private network: copy the scan to this computer first"
        )
