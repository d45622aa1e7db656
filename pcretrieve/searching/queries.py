"""What a query names: a shape of the catalogue, the file of a scan, the scans of a folder, or a signature."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from pcretrieve.catalogue import Catalogue
from pcretrieve.errors import DegenerateMeshError, InputError, ScanReadError
from pcretrieve.options import PipelineOptions
from pcretrieve.values import Signature, Verdict

__all__ = ["Described", "Query", "pictured", "queries_of", "query_of"]


@dataclass(frozen=True, slots=True, eq=False)
class Described:
    """The signature of a query."""

    signature: Signature
    verdict: Verdict | None = None
    picture: bytes | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Query:
    """One query of a search."""

    name: str
    of: str | Path | Signature


def pictured(scan: Path, options: PipelineOptions, up: str | None = None) -> Described:
    """Process a scan, and draw a thumbnail of its surface."""
    # Imported here, because shapes of the catalogue are found without the stages.
    from pcretrieve.draw import thumbnail, upward
    from pcretrieve.pipeline.process import described_shape

    described, verdict, shape = described_shape(scan, options)
    mesh, picture = shape.surfaces[0].mesh, None
    if mesh is not None:
        with suppress(DegenerateMeshError):
            picture = thumbnail(mesh.vertices, mesh.faces, up=mesh.up if up is None else upward(up))
    return Described(described, verdict, picture)


def query_of(catalogue: Catalogue, query: str | Path | Signature, *, is_converted: bool) -> Query:
    """Find what a query names.

    is_converted: whether files are read in another unit than those of the catalogue, so that a shape of the
        same content does not stand for them.
    """
    if isinstance(query, Signature):
        return Query(query.kind, query)
    path, name = Path(query), str(query)
    # Readers are imported for files only, because they are not needed to look up an id.
    if isinstance(query, str) and (path.is_dir() or not (path.exists() or _is_in_a_file(path))):
        return Query(name, _stored(catalogue, query))
    if is_converted:
        return Query(name, path)
    from pcretrieve.ingestion.discover import content_hash

    done = (record.id for record in catalogue.with_content(content_hash(path)) if record.status == "done")
    return Query(name, next(done, path))


def queries_of(
    catalogue: Catalogue, queries: Iterable[str | Path | Signature], *, is_converted: bool
) -> list[Query]:
    """Find what several queries name."""
    return [found for query in queries for found in _expanded(catalogue, query, is_converted=is_converted)]


def _expanded(catalogue: Catalogue, query: str | Path | Signature, *, is_converted: bool) -> Iterator[Query]:
    """The queries of a folder, or the one query that is given."""
    scans: list[str | Path | Signature] = [query]
    is_folder = not isinstance(query, Signature) and Path(query).is_dir()
    if is_folder and (isinstance(query, Path) or catalogue.get(str(query)) is None):
        from pcretrieve.ingestion.discover import discover

        scans = list(discover([str(query)]))
    for scan in scans:
        try:
            yield query_of(catalogue, scan, is_converted=is_converted)
        except ScanReadError:
            yield Query(str(scan), Path(str(scan)))  # reading it as a scan will report why


def _is_in_a_file(path: Path) -> bool:
    """Whether a path ``file#name`` names one of the scans in a file."""
    if "#" not in path.name:
        return False
    from pcretrieve.formats import split_member

    return split_member(path)[0].exists()


def _stored(catalogue: Catalogue, shape_id: str) -> str:
    """An id, after a check that its shape has a signature."""
    record = catalogue.get(shape_id)
    if record is None:
        raise InputError(
            f"a query must be the file of a scan or the id of a shape, {shape_id!r} is no file and no shape "
            f"of {catalogue.location}; `pcretrieve list` names the shapes{catalogue.suggested(shape_id)}"
        )
    if record.status != "done":
        raise InputError(
            f"shape {shape_id!r} has no signature: it failed in {record.stage}: {record.message}"
        )
    return shape_id
