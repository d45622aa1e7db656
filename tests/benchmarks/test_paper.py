"""The checks of the paper: each finds what it must where the answer is known, and printed figures hold."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import shapes
from PIL import Image

from pcretrieve.benchmarks.paper.appendix_a import appendix_a, deformed, discrepancies
from pcretrieve.benchmarks.paper.drums import drums
from pcretrieve.benchmarks.paper.figure_6 import FIGURE_6, Element, drum_spectra
from pcretrieve.benchmarks.paper.figure_7 import convergence_rate, figure_7, truncation_errors
from pcretrieve.benchmarks.paper.section_4_4 import drifts, noisy, perturbed
from pcretrieve.benchmarks.paper.spectra import reduced_eigenvalues, unit_area_spectrum
from pcretrieve.surface import defects
from pcretrieve.types import ModalSpectrum, TriangleMesh

SCRIPT = Path(__file__).parents[2] / "scripts" / "reproduce_paper"


def spread(mesh: TriangleMesh) -> float:
    """∫ |x − centre|² over a flat surface: the same for congruent ones, exact by midpoints of edges."""
    areas = mesh.face_areas
    corners = mesh.vertices[mesh.faces]  # (m, 3, 3)
    centre = (areas[:, None] * corners.mean(axis=1)).sum(axis=0) / areas.sum()
    middles = (corners + np.roll(corners, 1, axis=1)) / 2 - centre
    return float((areas * (middles**2).sum(axis=2).mean(axis=1)).sum())


def test_drums_are_flat_disks_of_seven_half_squares_that_are_not_congruent() -> None:
    both = drums(16)
    for drum in both:
        assert len(drum.vertices) == 969
        assert drum.euler_characteristic == 1
        corners = drum.vertices[drum.faces]
        signed = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] / 2
        np.testing.assert_allclose(signed, 7 / 8 / len(drum.faces))
        found = defects(drum)
        # A tree of seven triangles leaves nine of their sides open.
        assert found.boundary_edges == 9 * 16
        assert not found.non_manifold_edges
        assert found.components == 1
        # Triangles that overlapped would have their middles at one place.
        middles = np.round(corners.mean(axis=1), 6)
        assert len(np.unique(middles, axis=0)) == len(drum.faces)
    assert abs(spread(both[0]) / spread(both[1]) - 1) > 0.01


@pytest.mark.parametrize(("element", "n_cuts"), [("linear", 16), ("cubic", 6)])
def test_drums_sound_alike_and_have_different_signatures(element: Element, n_cuts: int) -> None:
    columns = drum_spectra(element, n_cuts)
    np.testing.assert_allclose(columns[:, 0], columns[:, 1], rtol=1e-9)
    off = np.abs(columns[:, 3] / columns[:, 2] - 1)
    assert off.max() > 0.3
    assert off[0] > 0.01


def test_figure_6_comes_out_as_printed() -> None:
    """The meshes of the paper are other ones: its two columns of one spectrum differ by up to 3e-3."""
    columns = drum_spectra("linear")
    np.testing.assert_allclose(columns[:, :2], FIGURE_6[:, :2], rtol=3e-3)
    np.testing.assert_allclose(columns[:, 2:], FIGURE_6[:, 2:], rtol=5e-3)


def round_sphere(degree: int) -> ModalSpectrum:
    """Of unit area, all harmonics up to a degree: λ = 4π l (l + 1), each 2l + 1 times, and g is constant."""
    degrees = np.repeat(np.arange(degree + 1), 2 * np.arange(degree + 1) + 1)
    eigenvalues = (4 * np.pi * degrees * (degrees + 1)).astype(np.float64)
    return ModalSpectrum(eigenvalues, np.zeros((len(degrees), len(degrees))), 1.0)


def test_on_the_sphere_the_error_is_the_tail_of_one_sum() -> None:
    spectrum = round_sphere(24)
    modes = tuple((degree + 1) ** 2 - 1 for degree in (6, 8, 10, 12, 14))
    errors = truncation_errors(spectrum, modes)
    terms = 2 / spectrum.eigenvalues[1:] ** 2
    np.testing.assert_allclose(errors, [terms[m:].sum() / terms.sum() for m in modes], rtol=1e-9)
    assert convergence_rate(modes, errors, len(terms)) == pytest.approx(1, abs=0.05)


def test_rate_sees_through_a_finite_reference() -> None:
    modes = (40, 60, 100, 200)
    errors = 3 * (np.array(modes) ** -1.5 - 300**-1.5)
    assert convergence_rate(modes, errors, 300) == pytest.approx(1.5, abs=1e-6)


def test_noise_is_as_large_as_it_says_and_along_the_normals() -> None:
    sphere = shapes.icosphere(4)
    moved = noisy(sphere, 0.3, np.random.default_rng(0)).vertices - sphere.vertices
    radial = (moved * sphere.vertices).sum(axis=1)
    assert (
        np.linalg.norm(moved - radial[:, None] * sphere.vertices, axis=1).max() < 0.01 * np.abs(radial).max()
    )
    corners = sphere.vertices[sphere.faces]
    edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean()
    assert radial.std() == pytest.approx(0.3 * edge, rel=0.05)


def test_drift_is_nothing_for_the_same_pose_and_grows_with_noise() -> None:
    bodies = shapes.body(2), shapes.ellipsoid(subdivisions=2)
    same = {str(number): (mesh, shapes.moved(mesh, number, scale=3)) for number, mesh in enumerate(bodies)}
    table = drifts(same, ("r-bihdm", "shape-dna"))
    assert table["pose"].shape == (2, 2)
    assert table["pose"].max() < 1e-6
    assert (table["noise 0.1"] < table["noise 0.5"]).all()
    assert all((rows > 0).all() for name, rows in table.items() if name != "pose")
    assert (table["holes 1%"] < 1).all()


def test_perturbations_do_what_their_names_say() -> None:
    mesh = shapes.body(2)
    made = dict(perturbed(mesh, np.random.default_rng(0)))
    for name, share in (("holes 1%", 0.01), ("holes 3%", 0.03)):
        assert len(made[name].faces) == pytest.approx((1 - share) * len(mesh.faces), abs=5)
        assert defects(made[name]).components == 1
    assert len(made["half faces"].faces) == len(mesh.faces) // 2
    assert made["fTetWild"].area == pytest.approx(mesh.area, rel=0.05)
    assert not defects(made["fTetWild"])


def test_discrepancy_by_hand() -> None:
    sums = discrepancies(np.array([4.0, -1.0]), np.array([3.0, -1.5]), 0.5, 2.0)
    np.testing.assert_allclose(sums, [0.5, 0.75])


def test_discrepancy_stays_bounded_for_r_bihdm_alone() -> None:
    mesh = shapes.body(4)
    before, after = (unit_area_spectrum(each, 160) for each in (mesh, deformed(mesh, 0.1)))
    mu, mu_after = (reduced_eigenvalues(spectrum, 160) for spectrum in (before, after))
    for alpha, p in ((0.0, 1.0), (0.5, 2.0)):
        sums = discrepancies(mu, mu_after, alpha, p)
        assert 1 < sums[79] / sums[19] < 1.05
    laplace = discrepancies(before.eigenvalues[1:], after.eigenvalues[1:], 0.0, 1.0)
    assert laplace[79] / laplace[39] > 2


def test_figure_7_is_drawn(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib, of the extra benchmark, is not installed")
    _, _, line, last = figure_7({"body": shapes.body(3)}, tmp_path / "figure7.png")
    assert last == f"wrote {tmp_path / 'figure7.png'}"
    row = line.split()
    errors = np.array(row[1:-1], dtype=float)
    assert (np.diff(errors) < 0).all()
    assert row[-1].startswith("m^-1.")
    with Image.open(tmp_path / "figure7.png") as picture:
        assert len(np.unique(np.asarray(picture.convert("L")))) > 2


def test_the_table_of_appendix_a_ends_with_what_the_theorem_says() -> None:
    rows = [line.split() for line in list(appendix_a({"body": shapes.body(3)}))[3:]]
    assert [row[1] for row in rows] == ["r-bihdm", "r-bihdm", "r-bihdm", "laplace"]
    for *_, before_last, last, bounded in rows:
        assert (float(last) < 1.02 * float(before_last)) == (bounded == "yes")


def test_it_prints_figure_6_and_says_what_it_leaves_out(tmp_path: Path) -> None:
    command = [sys.executable, str(SCRIPT), "--only", "figure6", "--only", "drift", "--data", str(tmp_path)]
    ended = subprocess.run(command, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    head, *_, last = ended.stdout.splitlines()
    assert head == "Figure 6, drums of 969 and 969 vertices"
    assert last.startswith("drift: left out, ")
