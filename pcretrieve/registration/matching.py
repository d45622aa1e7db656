"""Two views → the motions that may bring them together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pcretrieve.options import MergeOptions
from pcretrieve.registration.alignment import View, moved, turned
from pcretrieve.types import FloatArray

__all__ = ["candidate_motions", "distinct"]

# Of the points of a view, those whose features are farthest from the mean are looked up in another view, and
# that many look-alikes taken of each.
KEY_POINTS, LOOK_ALIKES = 1500, 4

# How far a pair of points must be apart to fix a motion, and by how much two pairs of look-alikes may
# differ: in their length (cells) and in the cosines between their line and their normals.
SHORTEST_PAIR, PAIR_LENGTH, PAIR_COSINE = 10, 1.5, 0.2

# Motions that are scored, and points of either view that they are scored by.
MOST_MOTIONS, FEW_POINTS = 1500, 200

# Agreement is counted within this many reaches: candidates are rough.
ROUGH = 2

# Motions that differ by less than this angle (cosine: 25 degrees) and this many cells lead to one place when
# they are refined.
SAME_COSINE, SAME_CELLS = 0.906, 10


def candidate_motions(
    first: View, second: View, scale: float, options: MergeOptions, rng: np.random.Generator
) -> FloatArray:
    """(m, 4, 4) motions of `second` into the frame of `first`, best first.

    Two oriented points fix a motion. Pairs of points in both views that look alike (by their features), are
    equally far apart and have normals at equal angles each propose one. Those are kept that both sensors bear
    out: where one saw a surface, the other saw the same and not through it.
    """
    cell = options.cell * scale
    here, there = _look_alikes(first.features, second.features)  # (l,), (l,)
    one, two = rng.integers(len(here), size=(2, options.n_tries))
    length, cosines, frame, middle = _pairs(first, here[one], here[two])
    other_length, other_cosines, other_frame, other_middle = _pairs(second, there[one], there[two])
    # 1 where two pairs are just as unlike as they may be.
    unlike = np.maximum(
        np.abs(length - other_length) / (PAIR_LENGTH * cell),
        np.abs(cosines - other_cosines).max(axis=1) / PAIR_COSINE,
    )  # (n_tries,)
    unlike[np.minimum(length, other_length) < SHORTEST_PAIR * cell] = np.inf
    chosen = np.argsort(unlike, kind="stable")[: min(MOST_MOTIONS, int((unlike < 1).sum()))]

    motions: FloatArray = np.tile(np.eye(4), (len(chosen), 1, 1))
    motions[:, :3, :3] = frame[chosen] @ other_frame[chosen].transpose(0, 2, 1)
    motions[:, :3, 3] = middle[chosen] - np.einsum("mij,mj->mi", motions[:, :3, :3], other_middle[chosen])
    tolerance = ROUGH * options.reach * scale
    score = _scores(first, second, motions, tolerance)
    score += _scores(second, first, np.linalg.inv(motions).astype(np.float64), tolerance)
    order = np.argsort(-score, kind="stable")
    best = motions[order[score[order] > 0]]
    return best[distinct(best, second, cell, most=options.n_candidates)]


def distinct(motions: FloatArray, view: View, cell: float, *, most: int) -> list[int]:
    """Positions of the first motions of a view that lead to different places, in order."""
    kept: list[int] = []
    middles = moved(motions, view.points.mean(axis=0, keepdims=True))[:, 0]  # (m, 3)
    for number, motion in enumerate(motions):
        if len(kept) == most:
            break
        cosine = (np.einsum("mij,ij->m", motions[kept, :3, :3], motion[:3, :3]) - 1) / 2
        apart = np.linalg.norm(middles[kept] - middles[number], axis=1)
        if not ((cosine > SAME_COSINE) & (apart < SAME_CELLS * cell)).any():
            kept.append(number)
    return kept


def _look_alikes(first: FloatArray, second: FloatArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Positions of points in two views that look alike, (l,) each."""
    usual = np.concatenate([first, second]).mean(axis=0)
    alike = []
    for features, others in ((first, second), (second, first)):
        # What looks like everything else, such as a plane, tells nothing.
        keys = np.argsort(-np.linalg.norm(features - usual, axis=1), kind="stable")[:KEY_POINTS]
        distance = (others**2).sum(axis=1) - 2 * features[
            keys
        ] @ others.T  # (keys, n): squared, less a constant
        n = min(LOOK_ALIKES, len(others))
        alike.append((np.repeat(keys, n), np.argpartition(distance, n - 1, axis=1)[:, :n].ravel()))
    (here, there), (back, forth) = alike
    return np.concatenate([here, forth]), np.concatenate([there, back])


def _pairs(
    view: View, one: NDArray[np.intp], two: NDArray[np.intp]
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Of pairs of oriented points: lengths (n,), cosines (n, 3), frames (n, 3, 3) and middles (n, 3)."""
    line = view.points[two] - view.points[one]
    length: FloatArray = np.linalg.norm(line, axis=1)
    line /= np.maximum(length, np.finfo(float).tiny)[:, None]
    start, end = (np.einsum("ij,ij->i", view.normals[ends], line) for ends in (one, two))
    between = np.einsum("ij,ij->i", view.normals[one], view.normals[two])
    up = view.normals[one] + view.normals[two] - (start + end)[:, None] * line
    up /= np.maximum(np.linalg.norm(up, axis=1), np.finfo(float).tiny)[:, None]
    frame = np.stack([line, up, np.cross(line, up)], axis=2)
    return length, np.stack([start, end, between], axis=1), frame, (view.points[one] + view.points[two]) / 2


def _scores(first: View, second: View, motions: FloatArray, tolerance: float) -> FloatArray:
    """(m,) agreements less contradictions: a few points of `second` in the picture of `first`, as shares."""
    few = second.sample[:FEW_POINTS]
    said = first.image.compare(
        moved(motions, second.points[few]), turned(motions, second.normals[few]), tolerance=tolerance
    )
    return np.asarray(said.agrees.mean(axis=1) - said.contradicts.mean(axis=1))
