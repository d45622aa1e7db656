"""Figure 6: the spectra of two isospectral drums, which R-BiHDM distinguishes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np

from pcretrieve.benchmarks.paper.drums import DRUM_CUTS, drums
from pcretrieve.benchmarks.paper.spectra import reduced_eigenvalues
from pcretrieve.spectral import eigenpairs, laplace_beltrami
from pcretrieve.values import FloatArray, ModalSpectrum

__all__ = ["FIGURE_6", "drum_spectra", "figure_6"]

N_MODES = 60

# The four columns of the figure: λ_1 … λ_10 of either drum, μ_0 … μ_9 of either.
FIGURE_6 = np.array(
    [
        [3.39832620, 3.39691613, 2.16530711e-1, 2.20749059e-1],
        [13.0603602, 13.0625695, -1.75187585e-1, -1.75999207e-1],
        [16.9851450, 16.9743079, -2.23163050e-2, -2.96890457e-2],
        [29.8711391, 29.8533596, -1.12679120e-2, -7.17493004e-3],
        [39.6051131, 39.6049419, -2.24496696e-3, -2.25092504e-3],
        [43.8536891, 43.8563295, -1.27777594e-3, -1.28146228e-3],
        [54.7970492, 54.6495812, -1.04506137e-3, -1.15918545e-3],
        [70.9875083, 71.0145921, -6.95901459e-4, -6.89618397e-4],
        [79.7177678, 79.7141696, -3.98584355e-4, -4.10728542e-4],
        [91.4966416, 91.7588846, -3.67194501e-4, -3.62850271e-4],
    ]
)

Element = Literal["linear", "cubic"]


def drum_spectra(element: Element, n_cuts: int = DRUM_CUTS) -> FloatArray:
    """The columns of figure 6, by one kind of finite elements.

    Parameters
    ----------
    element : {"linear", "cubic"}
        The finite elements.
    n_cuts : int, default 16
        As in `drums`.

    Returns
    -------
    (10, 4) float64
        λ_1 … λ_10 of either drum, unit length⁻², and μ_0 … μ_9 of either drum, unit length⁴.
    """
    columns = []
    for mesh in drums(n_cuts):
        pairs = eigenpairs(laplace_beltrami(mesh, element, boundary="neumann"), N_MODES + 1)
        mu = reduced_eigenvalues(ModalSpectrum.of(pairs), N_MODES)
        columns.append((pairs.eigenvalues[1:], mu))
    return np.column_stack(
        [column[: len(FIGURE_6)] for both in zip(*columns, strict=True) for column in both]
    )


def figure_6() -> Iterator[str]:
    """Both spectra of both drums, computed here and in the paper.

    Cubic elements show the error of linear elements at this size, which the paper uses too.

    Yields
    ------
    str
        A line of the table.
    """
    yield f"Figure 6, drums of {' and '.join(str(len(drum.vertices)) for drum in drums())} vertices"
    yield f"the paper's two drums differ by, relative: {_differing(FIGURE_6)}"
    elements: tuple[Element, ...] = ("linear", "cubic")
    for element in elements:
        columns = drum_spectra(element)
        off = np.abs(columns / FIGURE_6 - 1)
        yield f"{element} elements, pcretrieve's two drums differ by: {_differing(columns)}"
        yield "   " + "".join(f"{head:<38}" for head in ("λ I", "λ II", "R-BiHDM I", "R-BiHDM II")).rstrip()
        yield "   " + (4 * f"{'pcretrieve':<15}{'paper':<15}{'error':<8}").rstrip()
        for number, row in enumerate(np.stack([columns, FIGURE_6, off], axis=2)):
            cells = (f"{ours:<15.8g}{paper:<15.8g}{by:<8.0e}" for ours, paper, by in row)
            yield f"{number:<3}" + "".join(cells).rstrip()
        yield "   " + "".join(f"{'largest':<30}{by:<8.0e}" for by in off.max(axis=0)).rstrip()


def _differing(columns: FloatArray) -> str:
    """The largest relative difference of the two spectra of each kind."""
    one, other = columns[:, ::2], columns[:, 1::2]  # (10, 2)
    laplace, reduced = np.abs(other / one - 1).max(axis=0)
    return f"λ {laplace:.0e}, R-BiHDM {reduced:.0e}"
