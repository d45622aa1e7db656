"""Catalogue → what its shapes are among each other: clusters, copies, and places on a map."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator, Sequence
from itertools import permutations, product
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from pcretrieve.arrays import bounds, vertex_normals
from pcretrieve.catalogue import Catalogue, CatalogueLike
from pcretrieve.catalogue.cache import short_digest
from pcretrieve.descriptors.hapt import in_principal_frame
from pcretrieve.errors import OptionError, ShapeError
from pcretrieve.gallery.fitted import SMALLEST_KEPT, index, reference_of
from pcretrieve.options import OptionsLike, PipelineOptions
from pcretrieve.retrieval import SignatureIndex, pairwise
from pcretrieve.retrieval.people import RATES
from pcretrieve.values import FloatArray, Signature, TriangleMesh

# Largest distance of two copies of one body in one pose, by the logarithms of their moments: see
# docs/decisions.md, SAME.
SAME = 0.03

# Two people of one build in one pose have equal moments too. Copies are shapes whose signatures are nearer
# than this share of the pairs of two classes, or of two people by other scans where there are no classes.
FALSE_COPIES = 1e-4

# Largest distance of two surfaces that are one, along the normals, relative to √A; at this share of their
# vertices: see docs/decisions.md, ONE_SURFACE.
ONE_SURFACE = 0.007
SURFACE_SHARE = 0.95

# How two surfaces are turned and mirrored is told by each eighth of their vertices: see docs/decisions.md.
TURN_STEP = 8

# Effective number of neighbours of a point of t-SNE: by more, islands mix when shapes are moved apart.
PERPLEXITY = 12.0

# Least number of points of t-SNE, which starts at the principal components; fewer are projected on these. The
# divergence of 1,000 shapes is 4 % above that of 1,000 iterations at the angle 0.5, and looks the same.
FEWEST = 5
N_ITERATIONS = 300
ANGLE = 0.8
SEED = 0

# Distance between the shapes on a map, so that none hides another: nearly the width of a picture, or, of many
# shapes, this share of the mean spacing; and how often they are moved apart. Largest gap between neighbours
# along an axis, in mean gaps: islands that drift far apart would leave no room for what is in them.
GAP = 0.036
SHARE = 0.5
N_ROUNDS = 60
WIDEST = 5.0

GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))


class NearPair(NamedTuple):
    """Two near shapes.

    Attributes
    ----------
    first, second : str
        Their ids.
    distance, limit : float
        The distance of their signatures, and the largest one of copies.
    evidence : {"file", "surface", "body", ""}
        What makes them copies: one ``file``; one ``surface``, mirrored or not, such as two meshes of one
        scan, or two scans of a body that did not move; or one ``body`` in one pose. Empty if only signatures
        are compared.
    classes : tuple of str or None
        Their classes, of which two are a wrong label, or two bodies.
    """

    first: str
    second: str
    distance: float
    limit: float
    evidence: Literal["file", "surface", "body", ""] = ""
    classes: tuple[str | None, str | None] = (None, None)

    @property
    def is_of_one_class(self) -> bool:
        """Whether the classes of both are the same, as far as they are known."""
        return None in self.classes or self.classes[0] == self.classes[1]


def places(
    catalogue: CatalogueLike,
    ids: Sequence[str] | None = None,
    *,
    options: OptionsLike = None,
) -> FloatArray:
    """The places of shapes on a map, near each other where the shapes are similar.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The shapes. Maps of large catalogues are stored as indexes are.
    ids : sequence of str, optional
        The shapes on the map. By default all, in alphabetical order.
    options : OptionsLike, optional
        Signature and whitening. By default the options of the catalogue.

    Returns
    -------
    (n, 2) float64
        Within [0, 1]², by t-SNE of the whitened signatures.

    Raises
    ------
    CatalogueError, InputError, ShapeError
        As by `index`; InputError also if there is no shape of an id.
    """
    with Catalogue.opened(catalogue) as store:
        made = index(store, options=options)
        points = (
            made.points if ids is None else np.concatenate([*map(made.point_of, ids)])
        )
        # The first number is incremented when maps are drawn otherwise.
        name = f"map-1-{zlib.crc32(points.tobytes())}-{short_digest(store.revision())}"
        found: FloatArray | None = store.cache.opened(
            name, lambda arrays: arrays["places"]
        )
        if found is None:
            found = plane_map(points)
            if len(points) >= SMALLEST_KEPT:
                store.cache.keep(name, {"places": found})
        return found


def duplicates(
    catalogue: CatalogueLike,
    *,
    options: OptionsLike = None,
    threshold: float | None = None,
) -> list[NearPair]:
    """The pairs of shapes that are copies: of other resolutions, mirrored, or scanned twice in one pose.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The shapes, with their meshes unless there is a `threshold`. All are compared, incomplete ones too.
    options : OptionsLike, optional
        Signatures, distance and whitening. By default those of the catalogue.
    threshold : float, optional
        The largest distance of a pair. By default the moments of the surfaces are compared, up to `SAME`, and
        then the signatures, up to the distance of one in 10,000 pairs of two classes, or of two people where
        there are no classes.

    Returns
    -------
    list of NearPair
        Ids, distance and limit of each pair, what makes it one, and its classes; nearest first.

    Raises
    ------
    CatalogueError, InputError
        As by `search`.
    """
    with Catalogue.opened(catalogue) as store:
        chosen, compared, limit = _comparison(store, options, threshold)
        if not len(store):
            return []
        found = near_pairs(index(store, options=compared), limit)
        if threshold is None and found:
            found = _copies(store, chosen, found)
        label = store.labels()
        return [
            pair._replace(classes=(label[pair.first], label[pair.second]))
            for pair in found
        ]


def copies(
    catalogue: CatalogueLike,
    scans: Iterable[str | Path],
    *,
    options: OptionsLike = None,
    threshold: float | None = None,
) -> Iterator[tuple[str, list[NearPair] | ShapeError]]:
    """The shapes of a catalogue of which scans that are not stored are copies.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The shapes, as in `duplicates`.
    scans : iterable of str or Path
        Files of scans, or folders, which stand for all scans in them. Each scan is processed.
    options, threshold : object
        As in `duplicates`.

    Yields
    ------
    tuple of str and (list of NearPair or ShapeError)
        The path of a scan, and its pairs as by `duplicates`, with the path in place of the first id; or the
        error of a scan that cannot be read or has no usable surface.

    Raises
    ------
    CatalogueError, InputError
        As by `search`.
    """
    # Imported here, because stored shapes need no readers.
    from pcretrieve.formats.identity import content_hash
    from pcretrieve.ingestion.discover import discover
    from pcretrieve.pipeline.process import process, signature_of

    with Catalogue.opened(catalogue) as store:
        chosen, compared, limit = _comparison(store, options, threshold)
        made, label = index(store, options=compared), store.labels()
        for scan in discover([*scans]):
            name = str(scan)
            try:
                shape = process(scan, store.options)
                own = signature_of(shape, compared, scan)
                near = [*_within(made, own, limit)]
                if near and threshold is None:
                    own = signature_of(shape, chosen, scan)
            except ShapeError as error:
                yield name, error
                continue
            found = [
                NearPair(name, other, distance, limit, "", (None, label[other]))
                for other, distance in near
            ]
            if found and threshold is None:
                given = _Given(own, shape.mesh, content_hash(scan))
                found = _copies(store, chosen, found, given)
            yield name, found


def cluster(
    catalogue: CatalogueLike, *, options: OptionsLike = None, min_size: int = 3
) -> dict[str, str | None]:
    """Group the shapes of a catalogue without labels, by the density of their whitened signatures.

    Parameters
    ----------
    catalogue : Catalogue, str or Path
        The shapes.
    options : OptionsLike, optional
        Signature and whitening, without labels. By default the options of the catalogue.
    min_size : int, default 3
        Least number of shapes of a cluster.

    Returns
    -------
    dict of str to (str or None)
        For each shape, by id, ``cluster-1`` for the largest cluster, and so on; None for shapes in none.

    Raises
    ------
    CatalogueError, InputError
        As by `search`.
    """
    with Catalogue.opened(catalogue) as store:
        chosen = PipelineOptions.of(options, store.options).without_labels
        made = index(store, options=chosen)
    if min_size < 2:
        raise OptionError(f"min_size must be at least 2, got {min_size}")
    if len(made) < min_size:
        return dict.fromkeys(made.ids)
    from sklearn.cluster import HDBSCAN

    # Clusters from the excess of mass (Campello, Moulavi and Sander, 2013); −1 between clusters.
    method = HDBSCAN(min_cluster_size=min_size, cluster_selection_method="eom", copy=True)
    found = method.fit_predict(made.points)
    numbers, first, sizes = np.unique(
        found[found >= 0], return_index=True, return_counts=True
    )
    # Of equally large clusters, that with the first shape comes first.
    ranked = numbers[np.lexsort((first, -sizes))].tolist()
    names = {number: f"cluster-{rank}" for rank, number in enumerate(ranked, 1)}
    return dict(zip(made.ids, map(names.get, found.tolist()), strict=True))


def near_pairs(index: SignatureIndex, limit: float) -> list[NearPair]:
    """Find all pairs of shapes that are at most so far apart, nearest first."""
    found = [
        NearPair(shape_id, other, distance, limit)
        for shape_id in index.ids
        for other, distance in _within(index, shape_id, limit)
        if other > shape_id
    ]
    return sorted(found, key=lambda pair: (pair.distance, pair.first, pair.second))


def plane_map(points: FloatArray) -> FloatArray:
    """Places (N, 2) in [0, 1]², near each other where whitened signatures (N, L) are near, by t-SNE."""
    places = _embedding(points)
    # The direction of the largest extent is across, as on screens.
    places = (
        places @ np.linalg.svd(places - places.mean(axis=0), full_matrices=False)[2].T
    )
    for along in places.T:
        order = np.argsort(along, kind="stable")
        gaps = np.diff(along[order], prepend=along.min())
        along[order] = np.cumsum(np.minimum(gaps, WIDEST * gaps.mean()))
    return _framed(_apart(_framed(places), min(GAP, SHARE / np.sqrt(len(places)))))


class _Given(NamedTuple):
    """A scan that is compared, and not stored: its signature, its surface, and the hash of its file."""

    signature: Signature
    mesh: TriangleMesh
    content_hash: str


def _comparison(
    store: Catalogue, options: OptionsLike, threshold: float | None
) -> tuple[PipelineOptions, PipelineOptions, float]:
    """The options of a request, those by which shapes are compared first, and the largest distance."""
    chosen = PipelineOptions.of(options, store.options)
    if threshold is None:
        return chosen, chosen.of_copies, SAME
    if not 0 <= threshold < np.inf:
        raise OptionError(f"threshold must be 0 or more, got {threshold}")
    return chosen, chosen, threshold


def _within(
    index: SignatureIndex, query: str | Signature, limit: float
) -> Iterator[tuple[str, float]]:
    """The ids and distances of the shapes that are at most so far from a query, nearest first."""
    k = 4  # doubled until one is no longer near
    while (near := index.query(query, k)).distances[-1] <= limit and k < len(index):
        k *= 2
    for other, distance in zip(near.ids, near.distances.tolist(), strict=True):
        if distance <= limit:
            yield other, distance


def _copies(
    store: Catalogue,
    options: PipelineOptions,
    alike: Sequence[NearPair],
    given: _Given | None = None,
) -> list[NearPair]:
    """The pairs with like moments whose signatures are alike too, with the evidence.

    given: the first of each pair, if it is not stored.
    """
    made = index(store, options=options)
    limit = _largest_distance(made, options)
    found = []
    for pair in alike:
        one = made.point_of(given.signature if given else pair.first)
        other = made.point_of(pair.second)
        if pairwise(made.distance, one, other)[0, 0] <= limit:
            found.append(pair._replace(evidence=_evidence(store, pair, given)))
    return found


def _largest_distance(made: SignatureIndex, options: PipelineOptions) -> float:
    """The largest distance of the signatures of copies."""
    if made.scores is not None and len(made.scores.limits):
        return made.scores.limit(FALSE_COPIES)
    reference = reference_of(options, made.whitening)
    if reference is None:
        return np.inf
    return float(np.interp(FALSE_COPIES, RATES, reference.apart))


def _evidence(
    store: Catalogue, pair: NearPair, given: _Given | None
) -> Literal["file", "surface", "body"]:
    """What two shapes whose moments and signatures are alike have in common."""
    one = given or store[pair.first]
    if one.content_hash == store[pair.second].content_hash:
        return "file"
    mesh = given.mesh if given else store.mesh(pair.first)
    gap = _surface_gap(mesh, store.mesh(pair.second))
    return "surface" if gap <= ONE_SURFACE else "body"


def _surface_gap(one: TriangleMesh, other: TriangleMesh) -> float:
    """How far two surfaces are apart, turned and mirrored as they fit best, relative to √A.

    The quantile `SURFACE_SHARE` over the vertices of one of the distance from the tangent plane at the
    nearest vertex of the other, the smaller one of both ways: the vertices of a coarse copy lie on the fine
    surface, whose vertices lie beside the faces of the copy. The principal axes are the same but for their
    signs, which some of the vertices choose.
    """
    from scipy.spatial import cKDTree

    surfaces = [in_principal_frame(mesh) for mesh in (one, other)]
    sides = [
        (each.vertices, vertex_normals(each.vertices, each.faces), cKDTree(each.vertices))
        for each in surfaces
    ]

    def gap(signs: Sequence[float], step: int) -> float:
        gaps = []
        for (points, *_), (vertices, normals, tree) in permutations(sides):
            turned = points[::step] * signs
            near = tree.query(turned)[1]
            offsets = np.einsum("ij,ij->i", turned - vertices[near], normals[near])
            gaps.append(np.quantile(np.abs(offsets), SURFACE_SHARE))
        return float(min(gaps))

    turns = product((1.0, -1.0), repeat=3)
    return gap(min(turns, key=lambda signs: gap(signs, TURN_STEP)), 1)


def _framed(places: FloatArray) -> FloatArray:
    """Places in the middle of [0, 1]², which they fill in one direction."""
    low, high = bounds(places)
    return np.asarray((places - (low + high) / 2) / ((high - low).max() or 1.0) + 0.5)


def _apart(places: FloatArray, gap: float) -> FloatArray:
    """Move places apart that are nearer than a gap, several times, a quarter of what is missing each."""
    from scipy.spatial import cKDTree

    # Equal places have no direction in which they could be moved apart: they are put on a small spiral.
    angle = GOLDEN_ANGLE * np.arange(len(places))
    places = places + 1e-6 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    for _ in range(N_ROUNDS):
        pairs = cKDTree(places).query_pairs(gap, output_type="ndarray")
        if not len(pairs):
            break
        apart = places[pairs[:, 0]] - places[pairs[:, 1]]
        length = np.linalg.norm(apart, axis=1, keepdims=True)
        step = apart / length * (gap - length) / 4
        np.add.at(places, pairs[:, 0], step)
        np.add.at(places, pairs[:, 1], -step)
    return places


def _embedding(points: FloatArray) -> FloatArray:
    """Places (N, 2) at which near points (N, d) are near, by t-SNE (van der Maaten and Hinton, 2008)."""
    directions, sizes, _ = np.linalg.svd(
        points - points.mean(axis=0), full_matrices=False
    )
    principal = np.zeros((len(points), 2))
    principal[:, : min(2, len(sizes))] = (directions * sizes)[:, :2]
    if len(points) < FEWEST or not sizes[0]:
        return principal
    from sklearn.manifold import TSNE
    from threadpoolctl import threadpool_limits

    perplexity = min(PERPLEXITY, (len(points) - 1) / 3)
    start = (1e-4 * principal / principal.std()).astype(np.float32)
    method = TSNE(
        perplexity=perplexity,
        init=start,
        random_state=SEED,
        max_iter=N_ITERATIONS,
        angle=ANGLE,
    )
    with threadpool_limits(
        limits=1
    ):  # on busy cores two threads wait for each other, nine times as long
        return np.asarray(method.fit_transform(points), dtype=np.float64)
