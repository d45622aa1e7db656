"""Catalogue and query scan → ranked shapes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from pcretrieve.catalogue import Catalogue
from pcretrieve.descriptors import describe
from pcretrieve.errors import InputError
from pcretrieve.ingestion.discover import content_hash
from pcretrieve.matching import DistanceMatrix
from pcretrieve.options import PipelineOptions
from pcretrieve.retrieval import SignatureIndex
from pcretrieve.types import Neighbors, Signature

__all__ = ["search"]


def _signature(scan: Path, options: PipelineOptions) -> Signature:
    """As `pcretrieve.signature`, imported when it is called: a caller may do so in another process."""
    from pcretrieve.pipeline.process import signature

    return signature(scan, options)


def search(
    catalogue: Catalogue,
    scan: str | Path | Signature,
    *,
    k: int = 10,
    options: PipelineOptions | None = None,
    matrix: DistanceMatrix | None = None,
    describe_scan: Callable[[Path, PipelineOptions], Signature] = _signature,
) -> Neighbors:
    """The shapes of a catalogue nearest to a scan.

    Parameters
    ----------
    catalogue : Catalogue
    scan : str or Path
        Processed with the catalogue's own options; looked up by content where the catalogue holds it.
    k : int, default 10
    options : PipelineOptions, optional
        With a descriptor, a distance or a whitening other than the catalogue's own, such as
        ``catalogue.options.changed(retrieval={"whitening": "pca"})``.
    matrix : DistanceMatrix, optional
        Distances in place of those of signatures, to the scan that the catalogue holds.
    describe_scan : callable, optional
        What makes the signature of a scan that the catalogue does not hold, with the options that it is
        given; `pcretrieve.signature` by default, in this process.

    Raises
    ------
    CatalogueError
        If `options` are for other spectra than those of the catalogue.
    InputError
        If the catalogue holds no shapes; or, with `matrix`, not this scan.
    ShapeError
        If the scan cannot be read or has no usable surface.
    """
    options = options or catalogue.options
    if isinstance(scan, Signature):
        table = catalogue.signatures(options)
        return SignatureIndex(table, options.retrieval, whitening=catalogue.whitening(options)).query(scan, k)
    digest = content_hash(Path(scan))
    held = next((record for record in catalogue.with_content(digest) if record.status == "done"), None)
    if matrix is not None:
        if held is None:
            raise InputError(
                f"a distance matrix ranks shapes of {catalogue.path} only, which does not hold {scan}: leave "
                "out the matrix, or ingest the scan and make the matrix anew"
            )
        return matrix.nearest(held.id, k)
    table = catalogue.signatures(options)
    if not len(table):
        raise InputError(f"{catalogue.path} holds no shapes: ingest some first")
    if held:
        described = describe(catalogue.shape(held.id), options.compared)
    else:
        own = catalogue.options.model_copy(update={"signature": options.compared})
        described = describe_scan(Path(scan), own)
    index = SignatureIndex(table, options.retrieval, whitening=catalogue.whitening(options))
    return index.query(described.values, k)
