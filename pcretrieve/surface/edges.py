"""The edges of a triangulation, and the fans that faces form across them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

__all__ = ["Edges", "edges_of", "fans", "joined_by"]

Index = NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """Edges by way of half-edges: half-edge 3 f + k runs from corner k of face f to the next corner.

    Attributes
    ----------
    tail, head : (3m,) int
        Vertices that each half-edge runs from and to.
    order : (3m,) int
        Half-edges, those of one edge side by side.
    starts : (e,) int
        Where in `order` each edge begins.
    use : (e,) int
        Faces on each edge: 1 on a boundary, 2 inside a manifold.
    balance : (e,) int
        Half-edges of each edge that run up the vertex numbers, minus those that run down: 0 inside an
        oriented manifold.
    """

    tail: NDArray[np.integer]
    head: NDArray[np.integer]
    order: Index
    starts: Index
    use: Index
    balance: Index

    @property
    def ends(self) -> NDArray[np.integer]:
        """(e, 2) vertices at the ends of each edge."""
        first = self.order[self.starts]
        return np.column_stack([self.tail[first], self.head[first]])

    @property
    def crowd(self) -> Index:
        """(3m,) faces on the edge that each half-edge is of."""
        crowd = np.empty_like(self.order)
        crowd[self.order] = np.repeat(self.use, self.use)
        return crowd

    @property
    def pairs(self) -> Index:
        """(p, 2) the two half-edges of each edge that has two faces."""
        paired: Index = self.order[np.repeat(self.use == 2, self.use)].reshape(-1, 2)
        return paired

    def around(self, edge: int) -> Index:
        """The half-edges of one edge."""
        return self.order[self.starts[edge] : self.starts[edge] + self.use[edge]]


def edges_of(faces: NDArray[np.integer]) -> Edges:
    """The edges of (m, 3) faces."""
    tail, head = faces.ravel(), faces[:, [1, 2, 0]].ravel()  # (3m,)
    low, high = np.minimum(tail, head).astype(np.int64), np.maximum(tail, head)
    key = low * (int(high.max(initial=0)) + 1) + high
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    direction = np.where(tail < head, 1, -1)
    return Edges(
        tail=tail,
        head=head,
        order=order,
        starts=starts,
        use=np.diff(starts, append=len(order)),
        balance=np.add.reduceat(direction[order], starts),
    )


def fans(edges: Edges, pairs: Index) -> Index:
    """(3m,) the fan of each corner: corners that meet across paired half-edges are in one fan.

    Parameters
    ----------
    edges : Edges
    pairs : (p, 2) int
        Half-edges whose faces stay joined.
    """
    # Half-edge c starts at corner c and ends at corner after[c].
    corner = np.arange(len(edges.tail))
    after = np.where(corner % 3 == 2, corner - 2, corner + 1)
    a, b = pairs.T
    parallel = edges.tail[a] == edges.tail[b]  # so run the half-edges of faces that disagree on a side
    return joined_by(
        np.concatenate([a, after[a]]),
        np.concatenate([np.where(parallel, b, after[b]), np.where(parallel, after[b], b)]),
        len(corner),
    )


def joined_by(a: NDArray[np.integer], b: NDArray[np.integer], n: int) -> Index:
    """(n,) number of the class of each of n things, where a[i] and b[i] are in one class.

    Classes are numbered in the order of their first members.
    """
    graph = coo_array((np.ones(len(a), dtype=np.int8), (a, b)), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.intp)
