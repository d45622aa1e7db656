"""Spectra of surfaces, and of the reduced matrix of the squared biharmonic distance."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import curve_fit

from benchmarks.measuring import Column, Table, draw_curves
from pcretrieve.descriptors import reduced_matrix
from pcretrieve.spectral import eigenpairs, laplace_beltrami
from pcretrieve.values import FloatArray, ModalSpectrum, TriangleMesh


def unit_area_spectrum(mesh: TriangleMesh, n_modes: int) -> ModalSpectrum:
    """Spectrum of a surface scaled to unit area, by linear elements."""
    return ModalSpectrum.of(eigenpairs(laplace_beltrami(mesh), n_modes + 1)).scaled(1.0)


def reduced_eigenvalues(spectrum: ModalSpectrum, n_modes: int) -> FloatArray:
    """(n_modes + 1,) eigenvalues of the reduced matrix, largest magnitude first; unit length⁴."""
    mu = np.linalg.eigvalsh(reduced_matrix(spectrum, n_modes))
    return np.asarray(mu[np.argsort(-np.abs(mu))], dtype=np.float64)


# Legs of the seven half-squares, and cuts along each of their sides: 969 vertices, the paper's "~1k".
DRUM_LEG = 0.5
DRUM_CUTS = 16

# The transvections x ↦ x + f(x) v of the Fano plane that the drums are built by, one for each side of a
# triangle, as rows (f, v) over the field of two elements. Of all triples of transvections this is the only
# one, up to names, whose two unfoldings of a half-square neither overlap, nor close up on themselves, nor are
# congruent.
TRANSVECTIONS = np.array(
    [[[0, 0, 1], [0, 1, 0]], [[0, 1, 0], [0, 0, 1]], [[1, 0, 1], [1, 1, 1]]]
)


def drums(n_cuts: int = DRUM_CUTS) -> tuple[TriangleMesh, TriangleMesh]:
    """Two isospectral flat surfaces of seven half-squares each, oriented upwards.

    Triangles are the points of the Fano plane on one drum and its lines on the other, and two triangles are
    neighbours across side k where the k-th of three collineations of order two swaps them. The two actions of
    the collineations have the same characters, so every function on one drum has a counterpart on the other
    [1]_; and as the mesh of every triangle is the mirror image of its neighbours' meshes, so has every finite
    element function.

    References
    ----------
    .. [1] P. Buser, J. Conway, P. Doyle and K.-D. Semmler, "Some planar isospectral domains", International
       Mathematics Research Notices 1994; the shapes are those of Gordon, Webb and Wolpert, 1992.
    """
    # (7, 3): points, and lines alike.
    plane = np.stack(np.unravel_index(np.arange(1, 8), (2, 2, 2)), axis=1)
    maps = (
        np.eye(3, dtype=int) + TRANSVECTIONS[:, 1, :, None] * TRANSVECTIONS[:, 0, None]
    )  # (3, 3, 3)
    place = np.array([4, 2, 1])  # of the binary digits
    of_points, of_lines = (
        plane @ by % 2 @ place - 1 for by in (maps.transpose(0, 2, 1), maps)
    )  # (3, 7)
    return _cut(_unfolded(of_points), n_cuts), _cut(_unfolded(of_lines), n_cuts)


def _unfolded(across: NDArray[np.integer]) -> FloatArray:
    """Corners (7, 3, 2) of seven triangles, unfolded into the plane, each the mirror image of its neighbours.

    across: (3, 7), the triangle beyond the side opposite corner k of each triangle; at the border, itself.
    """
    corners = {0: np.array([[0.0, 0.0], [DRUM_LEG, 0.0], [0.0, DRUM_LEG]])}
    order = [0]
    for triangle in order:
        for k in range(3):
            neighbor = int(across[k, triangle])
            if neighbor in corners:
                continue
            mirrored = corners[triangle].copy()
            start, end = np.delete(mirrored, k, axis=0)
            side = (end - start) / np.linalg.norm(end - start)
            apex = mirrored[k] - start
            mirrored[k] = start + 2 * (apex @ side) * side - apex
            corners[neighbor] = mirrored
            order.append(neighbor)
    return np.stack([corners[triangle] for triangle in order])


def _cut(corners: FloatArray, n: int) -> TriangleMesh:
    """Triangles (t, 3, 2) cut into n² similar triangles each, in one surface."""
    grid = [(i, j) for i in range(n + 1) for j in range(n + 1 - i)]
    number = {place: k for k, place in enumerate(grid)}
    faces = np.array(
        [(number[i, j], number[i + 1, j], number[i, j + 1]) for i, j in grid if i + j < n]
        + [
            (number[i + 1, j], number[i + 1, j + 1], number[i, j + 1])
            for i, j in grid
            if i + j < n - 1
        ]
    )  # (n², 3)
    weights = np.array([(n - i - j, i, j) for i, j in grid]) / n  # (v, 3)
    places, vertex = np.unique(
        np.round(weights @ corners, 9).reshape(-1, 2), axis=0, return_inverse=True
    )  # (tv,)
    all_faces = vertex.reshape(len(corners), -1)[:, faces].astype(np.int32)  # (t, n², 3)
    upside_down = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0  # (t,)
    all_faces[upside_down] = all_faces[upside_down, :, ::-1]
    return TriangleMesh(np.pad(places, ((0, 0), (0, 1))), all_faces.reshape(-1, 3))


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
    """The columns (10, 4) of figure 6, by one kind of finite elements."""
    columns = []
    for mesh in drums(n_cuts):
        pairs = eigenpairs(
            laplace_beltrami(mesh, element, boundary="neumann"), N_MODES + 1
        )
        mu = reduced_eigenvalues(ModalSpectrum.of(pairs), N_MODES)
        columns.append((pairs.eigenvalues[1:], mu))
    return np.column_stack(
        [
            column[: len(FIGURE_6)]
            for both in zip(*columns, strict=True)
            for column in both
        ]
    )


def figure_6() -> Iterator[str]:
    """Both spectra of both drums, computed here and in the paper.

    Cubic elements show the error of linear elements at this size, which the paper uses too.
    """
    yield f"Figure 6, drums of {' and '.join(str(len(drum.vertices)) for drum in drums())} vertices"
    yield f"the paper's two drums differ by, relative: {_differing(FIGURE_6)}"
    elements: tuple[Element, ...] = ("linear", "cubic")
    for element in elements:
        columns = drum_spectra(element)
        off = np.abs(columns / FIGURE_6 - 1)
        yield f"{element} elements, pcretrieve's two drums differ by: {_differing(columns)}"
        yield (
            "   "
            + "".join(
                f"{head:<38}" for head in ("λ I", "λ II", "R-BiHDM I", "R-BiHDM II")
            ).rstrip()
        )
        yield "   " + (4 * f"{'pcretrieve':<15}{'paper':<15}{'error':<8}").rstrip()
        for number, row in enumerate(np.stack([columns, FIGURE_6, off], axis=2)):
            cells = (f"{ours:<15.8g}{paper:<15.8g}{by:<8.0e}" for ours, paper, by in row)
            yield f"{number:<3}" + "".join(cells).rstrip()
        yield (
            "   "
            + "".join(f"{'largest':<30}{by:<8.0e}" for by in off.max(axis=0)).rstrip()
        )


def _differing(columns: FloatArray) -> str:
    """The largest relative difference of the two spectra of each kind."""
    one, other = columns[:, ::2], columns[:, 1::2]  # (10, 2)
    laplace, reduced = np.abs(other / one - 1).max(axis=0)
    return f"λ {laplace:.0e}, R-BiHDM {reduced:.0e}"


# Number of eigenvalues that are compared, and number of modes of the reference.
N_CONVERGING = 30
MODES = (40, 50, 60, 80, 100, 120, 160, 200, 240)
N_REFERENCE = 480


def figure_7(meshes: Mapping[str, TriangleMesh], plot: Path | None) -> Iterator[str]:
    """Errors against the number of modes m with their rates; and a picture of both."""
    errors = {
        name: truncation_errors(unit_area_spectrum(mesh, N_REFERENCE), MODES)
        for name, mesh in meshes.items()
    }
    rates = {
        name: convergence_rate(MODES, row, N_REFERENCE) for name, row in errors.items()
    }
    yield (
        f"Figure 7: largest (μ_m − μ)² / (μ_m μ) of the first {N_CONVERGING} eigenvalues μ_m of m modes, "
        f"μ of {N_REFERENCE}"
    )
    yield f"{'m':<10}" + "".join(f"{m:<9}" for m in MODES) + "rate"
    for name, row in errors.items():
        yield (
            f"{name:<10}"
            + "".join(f"{error:<9.1e}" for error in row)
            + f"m^-{rates[name]:.2f}"
        )
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
    """Largest (μ_m − μ)² / (μ_m μ) of the reduced matrices of m modes against that of all modes.

    This is about the square of the relative error, and a term of the square of D2 (equation 11).
    """
    exact = reduced_eigenvalues(spectrum, len(spectrum.eigenvalues) - 1)[:n_values]
    # (len(modes), n_values).
    cuts = np.array([reduced_eigenvalues(spectrum, m)[:n_values] for m in modes])
    errors: FloatArray = ((cuts - exact) ** 2 / (cuts * exact)).max(axis=1)
    return errors


def convergence_rate(
    modes: tuple[int, ...], errors: FloatArray, n_reference: int
) -> float:
    """The exponent p of the law C m⁻ᵖ against infinitely many modes, fitted to errors against finitely many.

    An eigenvalue of m modes differs from that of M modes by a multiple of m^(−p/2) − M^(−p/2), of which the
    errors, as by `truncation_errors`, are the squares.
    """

    def law(m: FloatArray, log_size: float, p: float) -> FloatArray:
        logs: FloatArray = log_size + 2 * np.log(m ** (-p / 2) - n_reference ** (-p / 2))
        return logs

    (_, p), _ = curve_fit(
        law, np.array(modes, dtype=float), np.log(errors), p0=(0.0, 2.0)
    )
    return float(p)


# The kernel d² is Lipschitz and its eigenvalues fall as n⁻²: Theorem 6.3, with ε = 1, q = 1 and δ = 0, holds
# where 3p/2 > 2α + 1. It does for the first two of these (α, p), and not for the third.
EXPONENTS = ((0.0, 1.0), (0.5, 2.0), (1.0, 1.0))
COUNTS = (5, 10, 20, 40, 80, 160)
N_MODES_APPENDIX = 320
DEFORMATION = 0.1

TABLE = Table(
    Column("mesh", 9, align="<"),
    Column("spectrum", 9, align="<"),
    Column("α", 4),
    Column("p", 3),
    *(Column(f"n={n}", 8, ".3g") for n in COUNTS),
    Column("bounded", 8),
)


def appendix_a(meshes: Mapping[str, TriangleMesh]) -> Iterator[str]:
    """The discrepancy d_n of R-BiHDM, and of the Laplace spectrum, as n grows."""
    yield f"Appendix A: d_n / d_{COUNTS[0]} under a smooth deformation by {DEFORMATION:.0%}"
    yield "bounded: whether Theorem 6.3 says so, 3p/2 > 2α + 1"
    yield TABLE.head
    for name, mesh in meshes.items():
        spectra = [
            unit_area_spectrum(each, N_MODES_APPENDIX)
            for each in (mesh, deformed(mesh, DEFORMATION))
        ]
        mu, mu_after = (
            reduced_eigenvalues(spectrum, N_MODES_APPENDIX) for spectrum in spectra
        )
        lam, lam_after = (spectrum.eigenvalues[1:] for spectrum in spectra)
        kinds = [("r-bihdm", mu, mu_after, *each) for each in EXPONENTS]
        for kind, before, after, alpha, p in [
            *kinds,
            ("laplace", lam, lam_after, 0.0, 1.0),
        ]:
            sums = discrepancies(before, after, alpha, p)
            bounded = kind == "r-bihdm" and 1.5 * p > 2 * alpha + 1
            ratios = (sums[n - 1] / sums[COUNTS[0] - 1] for n in COUNTS)
            yield TABLE.row(name, kind, alpha, p, *ratios, "yes" if bounded else "no")


def deformed(mesh: TriangleMesh, amount: float) -> TriangleMesh:
    """Deform a mesh by a smooth map of space that is not an isometry."""
    phase = 2 * np.pi / mesh.diagonal * mesh.vertices
    return TriangleMesh(
        mesh.vertices
        + amount * mesh.diagonal / (2 * np.pi) * np.sin(np.roll(phase, 1, axis=1)),
        mesh.faces,
    )


def discrepancies(
    mu: FloatArray, after: FloatArray, alpha: float, p: float
) -> FloatArray:
    """(n,) discrepancies of two spectra, by Theorem 6.2: d_n = Σ |μ_i|^−α |μ_i − μ'_i|^p over i ≤ n."""
    return np.asarray(np.cumsum(np.abs(mu) ** -alpha * np.abs(mu - after) ** p))
