"""Conditions of scanning: options of the virtual scanner, by name."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from pcretrieve.formats import write_cloud, write_mesh
from pcretrieve.simulation import (
    DamageOptions,
    RigOptions,
    UniformOptions,
    damaged,
    scan,
    scan_uniformly,
    write_ply,
)
from pcretrieve.values import TriangleMesh

__all__ = ["CONDITIONS", "DEFECTS", "write_scan"]

LEVELS: dict[str, dict[str, Any]] = {
    "easy": {"n_points": 100_000, "noise": 0.0005, "n_holes": 2, "hole_radius": 0.01, "outlier_share": 0.0},
    "typical": asdict(UniformOptions()),
    "harsh": {"n_points": 20_000, "noise": 0.003, "n_holes": 10, "hole_radius": 0.02, "outlier_share": 0.01},
}

# The options that cameras add to a level: the number of pixels, which suffices for its points, and flying
# pixels.
CAMERAS: dict[str, dict[str, Any]] = {
    "easy": {"pixels": 400, "flying_share": 0.01},
    "typical": {},
    "harsh": {"flying_share": 0.1},
}
SAMPLINGS = ("uniform", "uniform-sensors", "rig", "rig-sensors")

# The condition that has no points: the clean mesh, damaged.
DEFECTS = "defects"

CONDITIONS = (*(f"{level}-{sampling}" for level in LEVELS for sampling in SAMPLINGS), DEFECTS)
"""Names of the conditions: a level and a way of sampling, or `DEFECTS`."""


def write_scan(stem: Path, mesh: TriangleMesh, condition: str, rng: np.random.Generator) -> Path:
    """Scan a mesh under a condition, and write the scan.

    Parameters
    ----------
    stem : Path
        The path of the file without its suffix.
    mesh : TriangleMesh
        Closed, oriented outwards.
    condition : str
        One of `CONDITIONS`.
    rng : numpy.random.Generator
        Source of the random numbers.

    Returns
    -------
    Path
        The file: ``.ply`` with points alone, ``.pcd`` with sensor positions, ``.off`` for a damaged mesh.
    """
    if condition == DEFECTS:
        path = stem.with_suffix(".off")
        write_mesh(damaged(mesh, DamageOptions(), rng), path)
        return path
    level, sampling, *sensors = condition.split("-")
    if sampling == "uniform":
        cloud = scan_uniformly(mesh, UniformOptions(**LEVELS[level] | {"sensors": bool(sensors)}), rng)
    else:
        numbers = {name: value for name, value in LEVELS[level].items() if name != "sensors"}
        cloud = scan(mesh, RigOptions(**numbers | CAMERAS[level]), rng)
    if sensors:
        path = stem.with_suffix(".pcd")
        write_cloud(cloud, path)
    else:
        path = stem.with_suffix(".ply")
        write_ply(path, cloud.points)
    return path
