"""The nearest neighbours of a query among some of the shapes of an index."""

from __future__ import annotations

from collections.abc import Sequence

from pcretrieve.retrieval.distances import pairwise
from pcretrieve.retrieval.index import SignatureIndex
from pcretrieve.retrieval.ranking import nearest_of, position_of
from pcretrieve.values import Neighbors, Signature

__all__ = ["nearest_among"]


def nearest_among(index: SignatureIndex, query: str | Signature, ids: Sequence[str], k: int) -> Neighbors:
    """The nearest neighbours of a query among some shapes, all of which are compared.

    query: the id of a shape of the index, or a signature.
    """
    point = index.contents.point_of(query)
    known = [shape_id for shape_id in ids if shape_id in index.ids]
    rows = [position_of(index.ids, shape_id) for shape_id in known]
    distances = pairwise(index.distance, point, index.contents.filter.points[rows])[0]
    return nearest_of(known, distances, k)
