"""Breath and hair: how a person's surface differs between two scans that no pose explains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import csr_array, diags_array, eye_array

from benchmarks.bodies import Body
from pcretrieve.arrays import vertex_normals
from pcretrieve.values import FloatArray, TriangleMesh
from pcretrieve.values.geometry import adjacency

# Largest displacement of the chest, and largest thickness of hair, in metres.
CHEST, HAIR = 0.012, 0.03

# Where the chest of a person who stands is: its height, a standard deviation of it, what is below the neck,
# and half its breadth, relative to the height of the person.
MIDDLE, SPREAD, BELOW, BREADTH = 0.74, 0.045, 0.82, 0.105

# Height where heads begin, and where hair begins; over which height it becomes thick.
HEAD, HAIRLINE, RISE = 0.9, 0.9, 0.04

# How much thicker hair is in some places, relative to its mean, and the least share of that.
LUMPS, THINNEST = 0.35, 0.1

# Hair in styles: its least and largest thickness, in metres; the height of a bun, how much higher it is than
# other hair before it is smoothed, and a standard deviation of it; where hair falls to, and where flat hair
# begins; and their half breadth. Relative to the height, as is the half of the band where a place is sought.
STYLED = (0.01, 0.03)
BUN, BUN_HIGHER, BUN_SPREAD = 0.955, 3.0, 0.018
NAPE, FLAT, ACROSS, BAND = 0.83, 0.94, 0.06, 0.01

# Number of times that what moves vertices is averaged with that of neighbours.
N_SMOOTHED = 12


def breathing(
    bodies: Sequence[Body], seed: int, *, is_styled: bool = False
) -> list[Body]:
    """Bodies of one topology, each with breath and hair of its own; one of them must stand, by its name.

    is_styled: whether hair is a bun, falls to the neck, lies on the crown, or is not there; else it is uneven
    hair all over the scalp.
    """
    standing = next(body.mesh for body in bodies if body.name.endswith("_stand"))
    averaged = _averaging(standing)
    chest, scalp = (
        _smoothed(where, averaged) for where in _chest_and_scalp(standing.vertices)
    )
    styles = [_smoothed(where, averaged) for where in _styles(standing.vertices)]
    found = []
    for number, body in enumerate(bodies):
        rng = np.random.default_rng((seed, number))
        lumps = _smoothed(rng.standard_normal(len(scalp)), averaged)
        hair = (1 + LUMPS * lumps / lumps.std()).clip(THINNEST)
        moved = rng.uniform(0, CHEST) * chest
        if is_styled:
            moved += rng.uniform(*STYLED) * styles[rng.integers(len(styles))]
        else:
            moved += rng.uniform(0, HAIR) * scalp * hair
        plain = body.mesh
        normals = vertex_normals(plain.vertices, plain.faces)
        vertices = plain.vertices + moved[:, np.newaxis] * normals
        found.append(replace(body, mesh=TriangleMesh(vertices, plain.faces)))
    return found


def _chest_and_scalp(vertices: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n,) twice, from 0 to 1: how much vertices of somebody who stands belong to chest and scalp."""
    level, aside = _level_and_aside(vertices)
    z = vertices[:, 2]
    chest = np.exp(-0.5 * ((level - MIDDLE) / SPREAD) ** 2)
    chest[(aside > BREADTH) | (level > BELOW)] = 0
    head = z[level > HEAD]
    behind = 0.5 - (z - head.mean()) / (0.5 * np.ptp(head))
    return chest, ((level - HAIRLINE) / RISE).clip(0, 1) * behind.clip(0, 1)


def _styles(vertices: FloatArray) -> list[FloatArray]:
    """(n,) each: where a bun is of somebody who stands, hair to the neck, flat hair, and none."""
    level, aside = _level_and_aside(vertices)
    z, height = vertices[:, 2], np.ptp(vertices[:, 1])
    middle = z[level > HEAD].mean()
    behind = np.where((np.abs(level - BUN) < BAND) & (aside < BAND), z, np.inf).argmin()
    apart = np.linalg.norm(vertices - vertices[behind], axis=1)
    bun = BUN_HIGHER * np.exp(-0.5 * (apart / (BUN_SPREAD * height)) ** 2)
    near = aside < ACROSS
    falls, flat = near & (level > NAPE) & (z < middle), near & (level > FLAT)
    return [bun, falls.astype(float), flat.astype(float), np.zeros(len(vertices))]


def _level_and_aside(vertices: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n,) twice: how high vertices are, and how far to a side of the middle, relative to the height."""
    x, y, _ = vertices.T
    height = np.ptp(y)
    return (y - y.min()) / height, np.abs(x - np.median(x)) / height


def _averaging(mesh: TriangleMesh) -> csr_array:
    """(n, n) the half of each vertex, and the other half of its neighbours in the mean."""
    beside = adjacency(mesh)
    shares = 0.5 / np.maximum(beside.sum(axis=1), 1)
    return csr_array(0.5 * eye_array(beside.shape[0]) + diags_array(shares) @ beside)


def _smoothed(values: FloatArray, averaged: csr_array) -> FloatArray:
    for _ in range(N_SMOOTHED):
        values = averaged @ values
    return values
