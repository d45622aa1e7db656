"""Figure 7: how fast the leading eigenvalues of the reduced matrix converge with the number of modes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from scipy.optimize import curve_fit

from pcretrieve.adapters.matplotlib import draw_curves
from pcretrieve.benchmarks.paper.spectra import reduced_eigenvalues, unit_area_spectrum
from pcretrieve.values import FloatArray, ModalSpectrum, TriangleMesh

__all__ = ["convergence_rate", "figure_7", "truncation_errors"]

# Number of eigenvalues that are compared, and number of modes of the reference.
N_CONVERGING = 30
MODES = (40, 50, 60, 80, 100, 120, 160, 200, 240)
N_REFERENCE = 480


def figure_7(meshes: Mapping[str, TriangleMesh], plot: Path | None) -> Iterator[str]:
    """Errors against the number of modes m with their rates; and a picture of both.

    Parameters
    ----------
    meshes : mapping of name to TriangleMesh
        Closed surfaces.
    plot : Path or None
        The picture to write, in a format that matplotlib knows; None for no picture.

    Yields
    ------
    str
        A line of the table.

    Raises
    ------
    InputError
        If a picture is asked for, and matplotlib is not installed.
    """
    errors = {
        name: truncation_errors(unit_area_spectrum(mesh, N_REFERENCE), MODES) for name, mesh in meshes.items()
    }
    rates = {name: convergence_rate(MODES, row, N_REFERENCE) for name, row in errors.items()}
    yield (
        f"Figure 7: largest (μ_m − μ)² / (μ_m μ) of the first {N_CONVERGING} eigenvalues μ_m of m modes, "
        f"μ of {N_REFERENCE}"
    )
    yield f"{'m':<10}" + "".join(f"{m:<9}" for m in MODES) + "rate"
    for name, row in errors.items():
        yield f"{name:<10}" + "".join(f"{error:<9.1e}" for error in row) + f"m^-{rates[name]:.2f}"
    if plot is not None:
        draw_curves(
            plot,
            MODES,
            {f"{name}: $m^{{-{rates[name]:.2f}}}$": row for name, row in errors.items()},
            x_label="m, modes",
            y_label=f"largest $(\\mu_m - \\mu)^2 / (\\mu_m \\mu)$ of the first {N_CONVERGING}",
        )
        yield f"wrote {plot}"


def truncation_errors(
    spectrum: ModalSpectrum, modes: tuple[int, ...], n_values: int = N_CONVERGING
) -> FloatArray:
    """Errors of the reduced matrix of m modes against that of all modes, as the authors measure them.

    Parameters
    ----------
    spectrum : ModalSpectrum
        Its number of modes is the reference.
    modes : tuple of int
        The m.
    n_values : int, default 30
        Leading eigenvalues that are compared.

    Returns
    -------
    (len(modes),) float64
        Largest (μ_m − μ)² / (μ_m μ) of these eigenvalues: about the square of the relative error, and a
        term of the square of D2 (equation 11).
    """
    exact = reduced_eigenvalues(spectrum, len(spectrum.eigenvalues) - 1)[:n_values]
    cuts = np.array([reduced_eigenvalues(spectrum, m)[:n_values] for m in modes])  # (len(modes), n_values)
    errors: FloatArray = ((cuts - exact) ** 2 / (cuts * exact)).max(axis=1)
    return errors


def convergence_rate(modes: tuple[int, ...], errors: FloatArray, n_reference: int) -> float:
    """The exponent p of the law C m⁻ᵖ against infinitely many modes, fitted to errors against finitely many.

    An eigenvalue of m modes differs from that of M modes by a multiple of m^(−p/2) − M^(−p/2), of which the
    errors are the squares.

    Parameters
    ----------
    modes : tuple of int
        The m.
    errors : (len(modes),) float64
        As by `truncation_errors`, against the matrix of M modes; positive.
    n_reference : int
        M, greater than all m.

    Returns
    -------
    float
        By least squares of the logarithms.
    """

    def law(m: FloatArray, log_size: float, p: float) -> FloatArray:
        logs: FloatArray = log_size + 2 * np.log(m ** (-p / 2) - n_reference ** (-p / 2))
        return logs

    (_, p), _ = curve_fit(law, np.array(modes, dtype=float), np.log(errors), p0=(0.0, 2.0))
    return float(p)
