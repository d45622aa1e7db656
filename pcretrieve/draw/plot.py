"""Figures by matplotlib: arrays in, axes out.

matplotlib is installed by the extra ``plot`` (``pip install pcretrieve[plot]``). Functions draw into given
axes, so that several plots can be in one figure.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np

from pcretrieve.arrays import FloatArray, IntArray
from pcretrieve.errors import InputError

__all__ = [
    "draw_places",
    "plot_points",
    "plot_ranking",
    "plot_signature",
    "plot_spectrum",
    "plot_surface",
]

# Largest number of points that are drawn. More points take longer, without a visible difference.
MOST_POINTS = 20_000

# A light clay, as in the pictures of the pages.
CLAY = (0.86, 0.80, 0.74)

# Number of groups in a column of a key.
KEY_ROWS = 34


def _pyplot() -> Any:
    try:
        from matplotlib import pyplot
    except ImportError as error:
        raise InputError("plots need matplotlib: pip install 'pcretrieve[plot]'") from error
    return pyplot


def _axes(axes: Any, **more: Any) -> Any:
    return axes if axes is not None else _pyplot().figure().add_subplot(**more)


def _equal_box(axes: Any, points: FloatArray) -> None:
    """Give all three axes the same scale."""
    axes.set_box_aspect(np.maximum(np.ptp(points, axis=0), 1e-12 + np.ptp(points) * 1e-3))
    axes.set_xlabel("x")
    axes.set_ylabel("y")
    axes.set_zlabel("z")


def plot_points(points: FloatArray, axes: Any = None) -> Any:
    """Draw a point cloud in three dimensions.

    points: (n, 3) float64, coordinates. Of more than 20,000 points, points at regular steps are drawn.
    """
    axes = _axes(axes, projection="3d")
    shown = points[:: -(-len(points) // MOST_POINTS) or 1]
    axes.scatter(*shown.T, s=1, c=shown[:, 2], cmap="viridis", linewidths=0)
    _equal_box(axes, points)
    return axes


def plot_surface(vertices: FloatArray, faces: IntArray, axes: Any = None) -> Any:
    """Draw a shaded surface in three dimensions.

    vertices: (n, 3) float64, vertices of the surface, in any unit.
    faces: (m, 3) int32, vertex numbers of the triangles.
    """
    axes = _axes(axes, projection="3d")
    axes.plot_trisurf(*vertices.T, triangles=faces, color=CLAY, linewidth=0)
    _equal_box(axes, vertices)
    return axes


def plot_signature(
    values: FloatArray, kind: str, deviation: FloatArray | None = None, axes: Any = None
) -> Any:
    """Draw the values of a signature by their number, on a logarithmic scale if all are positive.

    values: (L,) float64, the signature.
    deviation: (L,) float64, optional, standard deviation of the logarithm of each value, drawn as an error
        bar.
    """
    axes = _axes(axes)
    numbers = np.arange(1, len(values) + 1)
    bars = None
    if deviation is not None:
        bars = [values - values * np.exp(-deviation), values * np.exp(deviation) - values]
    axes.errorbar(numbers, values, yerr=bars, marker="o", markersize=3, linewidth=1, capsize=2, label=kind)
    if (values > 0).all():
        axes.set_yscale("log")
    axes.set_xlabel("number of the value")
    axes.set_ylabel(kind)
    return axes


def plot_spectrum(eigenvalues: FloatArray, axes: Any = None) -> Any:
    """Draw eigenvalues by their number, starting from 0.

    eigenvalues: (k,) float64, ascending; unit length⁻².
    """
    axes = _axes(axes)
    axes.plot(np.arange(len(eigenvalues)), eigenvalues, marker="o", markersize=3, linewidth=1)
    axes.set_xlabel("number of the eigenvalue")
    axes.set_ylabel("eigenvalue, length⁻²")
    return axes


def plot_ranking(names: Sequence[str], distances: FloatArray, axes: Any = None) -> Any:
    """Draw the distances of neighbours as horizontal bars, the nearest at the top.

    distances: (k,) float64, dimensionless.
    """
    axes = _axes(axes)
    axes.barh(np.arange(len(names)), distances, color=CLAY)
    axes.set_yticks(np.arange(len(names)), labels=list(names))
    axes.invert_yaxis()
    axes.set_xlabel("distance")
    return axes


def draw_places(groups: Sequence[tuple[str | None, FloatArray, str, str]], *, title: str) -> bytes:
    """A picture (PNG) of places in the plane, with a key of the groups.

    groups: sequence of (str or None, (n, 2) float64, str, str), for each group its name (None: unknown), the
        places, a colour, and a marker of matplotlib.
    """
    _pyplot()  # raises an error if matplotlib is not installed
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 7), layout="constrained")
    axes = figure.subplots()
    for name, places, colour, marker in groups:
        axes.scatter(
            places[:, 0],
            places[:, 1],
            s=30,
            c=colour,
            marker=marker,
            edgecolors="white",
            linewidths=0.5,
            label="class unknown" if name is None else name,
        )
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_yticks([])
    axes.set_title(title)
    columns = -(-len(groups) // KEY_ROWS)
    figure.legend(loc="outside right upper", ncols=columns, fontsize="small", frameon=False)
    data = io.BytesIO()
    figure.savefig(data, dpi=150, bbox_inches="tight", format="png")
    return data.getvalue()
