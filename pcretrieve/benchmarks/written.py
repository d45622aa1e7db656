"""Sets as files: meshes and scans that are written for an ingest, and the published vectors of SHREC'14."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pcretrieve.benchmarks.fidelity.conditions import write_scan
from pcretrieve.benchmarks.progress import progress
from pcretrieve.benchmarks.sets import Item
from pcretrieve.formats import write_mesh
from pcretrieve.values import Metric, SignatureTable

__all__ = ["pooled_vectors", "written_set"]


def written_set(items: Sequence[Item], folder: Path, condition: str | None) -> dict[str, str]:
    """Write the meshes of a set, or scans of them.

    Parameters
    ----------
    items : sequence of Item
        The meshes.
    folder : Path
        Where they are written, unless they are there; the folder is made.
    condition : str or None
        The condition under which they are scanned, one of `CONDITIONS`; None for the meshes themselves.

    Returns
    -------
    dict of str to str
        Class by file name.
    """
    folder.mkdir(exist_ok=True)
    labels = {}
    for item in progress(items, folder.name):
        written = next(iter(folder.glob(f"{item.name}.*")), None)
        if written is None:
            written = _written(item, folder, condition)
        labels[written.name] = item.label
    return labels


def _written(item: Item, folder: Path, condition: str | None) -> Path:
    if condition is not None:
        return write_scan(folder / item.name, item.mesh, condition, np.random.default_rng(item.number))
    path = folder / f"{item.name}.off"
    write_mesh(item.mesh, path)
    return path


def pooled_vectors(path: Path, metric: Metric) -> SignatureTable:
    """The descriptors of SHREC'14 that Chiotellis et al. (ECCV 2016) publish.

    Parameters
    ----------
    path : Path
        A file of MATLAB.
    metric : {"values", "logarithms"}
        What is compared.

    Returns
    -------
    SignatureTable
        Means of the wave kernel signature (100 values) and of the scale-invariant heat kernel signature (50)
        over each surface, with the classes.
    """
    from scipy.io import loadmat

    arrays = loadmat(path)
    values = np.hstack([arrays["WksPooledMat"], arrays["SihksPooledMat"]])  # (N, 150)
    labels = tuple(str(number) for number in arrays["C"].ravel())
    ids = tuple(f"{number:04}" for number in range(len(labels)))
    return SignatureTable(ids, values, "csd", labels=labels, metric=metric)
