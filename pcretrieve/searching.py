"""Catalogue and query → ranked shapes.

In come a catalogue and a scan, a stored shape or a signature; out come the identifiers of the nearest shapes
and their distances.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from pcretrieve.catalogue import Catalogue
from pcretrieve.errors import InputError
from pcretrieve.options import PipelineOptions
from pcretrieve.retrieval import N_NEAR, reranked_neighbors
from pcretrieve.retrieval.ranking import checked_k
from pcretrieve.types import Neighbors, Signature

if TYPE_CHECKING:
    from pcretrieve.matching import DistanceMatrix

__all__ = ["search"]


def _signature(scan: Path, options: PipelineOptions) -> Signature:
    """The function `pcretrieve.signature`, imported when it is called, because a caller may replace it."""
    from pcretrieve.pipeline.process import signature

    return signature(scan, options)


def search(
    catalogue: Catalogue,
    query: str | Path | Signature,
    *,
    k: int = 10,
    options: PipelineOptions | None = None,
    matrix: DistanceMatrix | None = None,
    unit: str | None = None,
    describe_scan: Callable[[Path, PipelineOptions], Signature] = _signature,
) -> Neighbors:
    """Find the shapes of a catalogue nearest to a scan, to one of its shapes, or to a signature.

    Parameters
    ----------
    catalogue : Catalogue
        The catalogue that is searched.
    query : str, Path or Signature
        The file of a scan, which is processed with the options of the catalogue unless the catalogue has a
        shape of the same content; the id of a shape of the catalogue, as a str that is not the path of a
        file; or a signature that was made with the same options as the signatures of the catalogue.
    k : int, default 10
        Number of shapes. If the catalogue has fewer, all of them are returned.
    options : PipelineOptions, optional
        Options with another descriptor, distance or whitening than the options of the catalogue, such as
        ``catalogue.options.changed(retrieval={"whitening": "pca"})``.
    matrix : DistanceMatrix, optional
        Distances that replace the distances of signatures, for a query that the catalogue has.
    unit : str, optional
        Unit of the file of the query, if its format does not have one, a key of `METRES`; by default that of
        the options of the catalogue. Matters only if sizes are compared.
    describe_scan : callable, optional
        Computes the signature of a scan that the catalogue does not have, with given options; by default
        `pcretrieve.signature`, in this process.

    Returns
    -------
    Neighbors
        Nearest first; equal distances by identifier. A shape of the catalogue is its own neighbour.

    Raises
    ------
    CatalogueError
        If `options` require other spectra than the catalogue has.
    InputError
        If the catalogue has no shapes; if the query is neither a file nor the id of a shape; if sizes are
        compared, and the unit of the query is known and that of the shapes is not, or vice versa; or, with
        `matrix`, if the query is not in the catalogue.
    ShapeError
        If the scan cannot be read or has no usable surface.
    """
    options = options or catalogue.options
    is_converted = matrix is None and unit not in (None, catalogue.options.scan.unit)
    held = None if isinstance(query, Signature) else _held(catalogue, query, is_converted=is_converted)
    if matrix is not None:
        if held is None:
            raise InputError(
                f"a distance matrix ranks shapes of {catalogue.location} only, which does not hold {query}: "
                "leave out the matrix, or ingest the scan and make the matrix again"
            )
        return matrix.nearest(held, k)
    index, method = catalogue.index(options), options.retrieval.rerank
    # The neighbourhoods of the results, among which a list is sorted again, need more shapes than asked for.
    most = checked_k(k) if method == "none" else max(checked_k(k), N_NEAR)
    if held is not None:
        return _first(reranked_neighbors(index, index.nearest(held, most), method, shape_id=held), k)
    if isinstance(query, Signature):
        return _first(reranked_neighbors(index, index.query(query, most), method), k)
    own = catalogue.options.model_copy(update={"signature": options.compared})
    if unit is not None:
        own = own.changed(scan={"unit": unit})
    return _first(reranked_neighbors(index, index.query(describe_scan(Path(query), own), most), method), k)


def _first(found: Neighbors, k: int) -> Neighbors:
    return Neighbors(found.ids[:k], found.distances[:k])


def _held(catalogue: Catalogue, query: str | Path, *, is_converted: bool) -> str | None:
    """The id of the shape that a query names; None for a scan that it does not have, or in another unit."""
    path = Path(query)
    # Readers are imported for files only, because they are not needed to look up an id.
    if isinstance(query, str) and (path.is_dir() or not (path.exists() or _is_in_a_file(path))):
        return _stored(catalogue, query)
    if is_converted:
        return None
    from pcretrieve.ingestion.discover import content_hash

    done = (record.id for record in catalogue.with_content(content_hash(path)) if record.status == "done")
    return next(done, None)


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
            f"of {catalogue.location}; `pcretrieve list` names the shapes"
        )
    if record.status != "done":
        raise InputError(
            f"shape {shape_id!r} has no signature: it failed in {record.stage}: {record.message}"
        )
    return shape_id
