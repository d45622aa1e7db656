"""Catalogue and query scan → ranked shapes."""

from __future__ import annotations

from pathlib import Path

from pcretrieve.catalogue import Catalogue
from pcretrieve.descriptors import describe
from pcretrieve.errors import InputError
from pcretrieve.ingestion.discover import content_hash
from pcretrieve.matching import DistanceMatrix
from pcretrieve.options import PipelineOptions
from pcretrieve.pipeline.process import process
from pcretrieve.retrieval import SignatureIndex
from pcretrieve.types import Neighbors, Signature

__all__ = ["search"]


def search(
    catalogue: Catalogue,
    scan: str | Path | Signature,
    *,
    k: int = 10,
    options: PipelineOptions | None = None,
    matrix: DistanceMatrix | None = None,
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
    shape = catalogue.shape(held.id) if held else process(scan, catalogue.options)
    index = SignatureIndex(table, options.retrieval, whitening=catalogue.whitening(options))
    return index.query(describe(shape, options.compared).values, k)
