"""Figures by matplotlib (the extra ``plot``): arrays in, axes out.

Functions draw into given axes, or into those of a new figure, so that several plots can be in one figure.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np

from pcretrieve.arrays import FloatArray, IntArray
from pcretrieve.draw.pictures import CLAY, MOST_POINTS
from pcretrieve.errors import InputError

# Number of groups in a column of a key.
KEY_ROWS = 34


def plot_points(points: FloatArray, axes: Any = None) -> Any:
    """Draw a point cloud in three dimensions; of many points, those at regular steps."""
    axes = _axes(axes, projection="3d")
    shown = points[:: -(-len(points) // MOST_POINTS) or 1]
    axes.scatter(*shown.T, s=1, c=shown[:, 2], cmap="viridis", linewidths=0)
    return _with_one_scale(axes, points)


def plot_surface(vertices: FloatArray, faces: IntArray, axes: Any = None) -> Any:
    """Draw a shaded surface in three dimensions."""
    axes = _axes(axes, projection="3d")
    axes.plot_trisurf(*vertices.T, triangles=faces, color=CLAY, linewidth=0)
    return _with_one_scale(axes, vertices)


def plot_signature(
    values: FloatArray, kind: str, errors: FloatArray | None = None, axes: Any = None
) -> Any:
    """Draw the values of a signature by their number, on a logarithmic scale if all are positive.

    errors: (L,), standard deviation of the logarithm of each value, drawn as an error bar.
    """
    axes = _axes(axes)
    numbers = np.arange(1, len(values) + 1)
    bars = None
    if errors is not None:
        bars = [values - values * np.exp(-errors), values * np.exp(errors) - values]
    axes.errorbar(
        numbers,
        values,
        yerr=bars,
        marker="o",
        markersize=3,
        linewidth=1,
        capsize=2,
        label=kind,
    )
    axes.set(xlabel="number of the value", ylabel=kind)
    if (values > 0).all():
        axes.set_yscale("log")
    return axes


def draw_places(
    groups: Sequence[tuple[str | None, FloatArray, str]], *, title: str
) -> bytes:
    """A picture (PNG) of places in the plane, with a key of the groups.

    groups: for each group its name (None: unknown), the (n, 2) places, and a colour.
    """
    _pyplot()  # raises an error if matplotlib is not installed
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 7), layout="constrained")
    axes = figure.subplots()
    for number, (name, places, colour) in enumerate(groups):
        label = "class unknown" if name is None else name
        marker = "os^Dv"[number // 8 % 5]  # of more classes than colours
        x, y = places.T
        axes.scatter(
            x,
            y,
            s=30,
            c=colour,
            marker=marker,
            edgecolors="white",
            linewidths=0.5,
            label=label,
        )
    axes.set_aspect("equal")
    axes.set(xticks=[], yticks=[], title=title)
    columns = -(-len(groups) // KEY_ROWS)
    figure.legend(
        loc="outside right upper", ncols=columns, fontsize="small", frameon=False
    )
    return _saved(figure, "png")


def draw_recognition(curve: Sequence[Any], file_format: str) -> bytes:
    """A picture of the points of a `pcretrieve.evaluation.measures.recognition_curve`."""
    _pyplot()
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.subplots()
    known = [point for point in curve if not point.is_fitted]
    counts = [point.n_classes for point in known]
    low, high = [point.low for point in known], [point.high for point in known]
    axes.fill_between(counts, low, high, color="C0", alpha=0.2, linewidth=0)
    axes.plot(counts, [one.rank_1 for one in known], "o-C0", ms=4, label="rank-1")
    axes.plot(counts, [one.rank_5 for one in known], "s-C1", ms=4, label="rank-5")
    beyond = [known[-1], *curve[len(known) :]]
    if len(beyond) > 1:
        rates = [point.rank_1 for point in beyond]
        counts = [point.n_classes for point in beyond]
        axes.plot(counts, rates, "o--C0", ms=4, mfc="white", label="rank-1, fitted")
    axes.set_xscale("log")
    axes.set(xlabel="number of classes", ylabel="share of queries")
    axes.legend()
    return _saved(figure, file_format)


def _saved(figure: Any, file_format: str) -> bytes:
    data = io.BytesIO()
    figure.savefig(data, dpi=150, bbox_inches="tight", format=file_format)
    return data.getvalue()


def _pyplot() -> Any:
    try:
        from matplotlib import pyplot
    except ImportError as error:
        raise InputError(
            "plots need matplotlib: pip install 'pcretrieve[plot]'"
        ) from error
    return pyplot


def _axes(axes: Any, **more: Any) -> Any:
    return axes if axes is not None else _pyplot().figure().add_subplot(**more)


def _with_one_scale(axes: Any, points: FloatArray) -> Any:
    axes.set_box_aspect(np.maximum(np.ptp(points, axis=0), 1e-12 + np.ptp(points) * 1e-3))
    axes.set(xlabel="x", ylabel="y", zlabel="z")
    return axes
