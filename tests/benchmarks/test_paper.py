"""The checks of the paper: each finds what it must where the answer is known, and printed figures hold."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import shapes
from PIL import Image
from scipy.io import savemat

from pcretrieve.benchmarks.paper.appendix_a import appendix_a, deformed, discrepancies
from pcretrieve.benchmarks.paper.drums import drums
from pcretrieve.benchmarks.paper.figure_4 import figure_4
from pcretrieve.benchmarks.paper.figure_6 import FIGURE_6, Element, drum_spectra
from pcretrieve.benchmarks.paper.figure_7 import convergence_rate, figure_7, truncation_errors
from pcretrieve.benchmarks.paper.main import main
from pcretrieve.benchmarks.paper.section_4_4 import drifts, noisy, perturbed
from pcretrieve.benchmarks.paper.silhouettes import planar_mesh, read_silhouette
from pcretrieve.benchmarks.paper.spectra import reduced_eigenvalues, unit_area_spectrum
from pcretrieve.benchmarks.paper.table_5 import table_5, track
from pcretrieve.errors import BenchmarkError
from pcretrieve.formats import read_scan, write_mesh
from pcretrieve.surface import defects
from pcretrieve.values import ModalSpectrum, PointCloud, TriangleMesh

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


def ellipse(aspect: float, *, turned: bool = False, hole: float = 0.0) -> np.ndarray:
    """A picture of an ellipse of 200 pixels, with a round hole whose diameter is given relative to it."""
    y, x = np.mgrid[-120:121, -120:121] / 100
    x, y = (y, x) if turned else (x, y)
    return np.asarray((x**2 + (y / aspect) ** 2 <= 1) & (x**2 + y**2 >= hole**2), dtype=np.float64)


def test_the_mesh_of_a_disk_has_the_spectrum_of_a_disk() -> None:
    mesh = planar_mesh(ellipse(1.0))
    assert mesh.area == pytest.approx(np.pi * 100**2, rel=0.01)
    assert mesh.euler_characteristic == 1
    assert 6000 <= len(mesh.vertices) < 6400
    found = defects(mesh)
    assert (found.non_manifold_edges, found.components) == (0, 1)
    assert (mesh.area_vectors[:, 2] > 0).all()
    # The squares of the zeros of the derivatives of the Bessel functions J₁ (twice), J₂ (twice) and J₀.
    expected = np.pi * np.array([1.841184, 1.841184, 3.054237, 3.054237, 3.831706]) ** 2
    np.testing.assert_allclose(unit_area_spectrum(mesh, 5).eigenvalues[1:], expected, rtol=0.01)


def test_holes_of_silhouettes_stay_and_specks_go() -> None:
    picture = ellipse(1.0, hole=0.3)
    picture[:4, :4] = 1
    mesh = planar_mesh(picture, 2000)
    assert mesh.euler_characteristic == 0
    assert mesh.area == pytest.approx(picture.sum() - 16, rel=0.01)


def test_pictures_without_silhouettes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BenchmarkError, match="must have an interior"):
        planar_mesh(np.pad([[1.0]], 9))
    Image.new("L", (9, 9)).save(tmp_path / "black-1.gif")
    (tmp_path / "broken-1.gif").write_bytes(b"GIF89a")
    for name in ("black-1.gif", "broken-1.gif"):
        with pytest.raises(BenchmarkError, match=name):
            read_silhouette(tmp_path / name)


def test_figure_4_ranks_silhouettes_by_their_shape(tmp_path: Path) -> None:
    folder = tmp_path / "silhouettes"
    folder.mkdir()
    for name, aspect, hole in (("disk", 1.0, 0.0), ("ellipse", 0.5, 0.0), ("ring", 1.0, 0.4)):
        for number in (1, 2):
            picture = ellipse(aspect - 0.02 * number, turned=number == 2, hole=hole)
            Image.fromarray(np.asarray(255 * picture, dtype=np.uint8)).save(folder / f"{name}-{number}.gif")
    Image.new("L", (9, 9)).save(folder / "black-1.gif")
    head, failed, _, *rows, last = figure_4(folder, tmp_path / "strips.png")
    assert head.startswith("Figure 4: 6 silhouettes of 3 classes")
    assert failed.startswith("black-1.gif failed: ")
    assert len(rows) == 12
    assert all(row.split()[3:] == ["1.000", "1.000", "1.000"] for row in rows)
    assert last.startswith(f"wrote {tmp_path / 'strips.png'}")
    with Image.open(tmp_path / "strips.png") as picture:
        colours = {colour for _, colour in picture.getcolors(1 << 20) or ()}
    assert {(20, 24, 30), (170, 175, 182)} <= colours, "shapes of the class of the query, and others"


def round_sphere(degree: int) -> ModalSpectrum:
    """Of unit area, all harmonics up to a degree: λ = 4π l (l + 1), each 2l + 1 times, and g is constant."""
    degrees = np.repeat(np.arange(degree + 1), 2 * np.arange(degree + 1) + 1)
    eigenvalues = (4 * np.pi * degrees * (degrees + 1)).astype(np.float64)
    return ModalSpectrum(eigenvalues, np.zeros((len(degrees), len(degrees))), 1.0)


def test_on_the_sphere_the_error_is_that_of_the_tail_of_one_sum() -> None:
    spectrum = round_sphere(24)
    modes = tuple((degree + 1) ** 2 - 1 for degree in (6, 8, 10, 12, 14))
    errors = truncation_errors(spectrum, modes)
    terms = 2 / spectrum.eigenvalues[1:] ** 2
    total = terms.sum()
    tails = np.array([terms[m:].sum() for m in modes])
    np.testing.assert_allclose(errors, tails**2 / ((total - tails) * total), rtol=1e-9)
    assert convergence_rate(modes, errors, len(terms)) == pytest.approx(2, abs=0.1)


def test_rate_sees_through_a_finite_reference() -> None:
    modes = (40, 60, 100, 200)
    errors = 3 * (np.array(modes) ** -1.5 - 300**-1.5) ** 2
    assert convergence_rate(modes, errors, 300) == pytest.approx(3, abs=1e-6)


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
    assert row[-1].startswith("m^-2.")
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
    assert ended.stdout.startswith("Figure 6, drums of 969 and 969 vertices\n")
    assert "\ndrift: left out, " in ended.stdout


@pytest.fixture
def two_sets(tmp_path: Path) -> Path:
    """Small sets in the folders of SHREC'11 and of TOSCA: two classes of three ellipsoids each."""
    for name in ("shrec11", "tosca"):
        (tmp_path / name).mkdir()
        rows = ["file,class"]
        for label, length in (("short", 1.5), ("long", 3.0)):
            for number in range(3):
                mesh = shapes.ellipsoid((1, 1.2 + 0.03 * number, length), subdivisions=3)
                write_mesh(mesh, tmp_path / name / f"{label}{number}.off")
                rows.append(f"{label}{number}.off,{label}")
        (tmp_path / name / "labels.csv").write_text("\n".join(rows))
    return tmp_path


def test_figure_1_shows_each_class_once(two_sets: Path) -> None:
    folder = two_sets / "out"
    main(["--data", str(two_sets), "--output", str(folder), "--only", "figure1"])
    page = (folder / "paper.html").read_text("utf-8")
    assert "Figure 1: 6 meshes of shrec11, of 2 classes" in page
    assert '<img src="figure1.png"' in page
    with Image.open(folder / "figure1.png") as picture:
        drawn = np.asarray(picture.convert("L"), dtype=np.float64).min(axis=0) < 250
    # Two pictures side by side, and nothing to the right of them.
    assert (np.diff(drawn.astype(int)) == 1).sum() >= 2
    assert not drawn[drawn.size // 2 :].any()


def test_table_5_takes_the_sets_of_shrec14_by_the_names_of_their_layouts(two_sets: Path) -> None:
    for name, number in (("shrec11", "synthetic"), ("tosca", "real")):
        (two_sets / name).rename(two_sets / f"shrec14-{number}")
    rng = np.random.default_rng(0)
    labels = np.repeat(np.arange(10), 6)
    values = np.exp(0.5 * rng.normal(size=(10, 150)))[labels] * np.exp(0.1 * rng.normal(size=(60, 150)))
    (two_sets / "shrec14_csd").mkdir()
    arrays = {"WksPooledMat": values[:, :100], "SihksPooledMat": values[:, 100:], "C": labels}
    for name in ("synthetic", "real"):
        savemat(two_sets / "shrec14_csd" / f"{name}.mat", arrays)
    _, synthetic, real, columns, *rows = table_5(two_sets, full=False)
    assert (synthetic, real) == (
        "synthetic: 6 meshes of shrec14-synthetic",
        "real: 6 meshes of shrec14-real",
    )
    assert columns.split() == ["method", "L", "scale", "D", "synthetic", "real"]
    measured = {tuple(row.split()[:3]): row.split()[4:] for row in rows[: rows.index("")]}
    assert measured["r-bihdm", "59", "area"] == ["1.000", "(0.642)", "1.000", "(0.640)"]
    assert measured["hapt", "45", "area"][1::2] == ["(0.817)", "(0.637)"]
    assert measured["dl-supervised", "32", "area"][1::2] == ["(0.954)", "(0.791)"]
    *_, by_classes = (row.split() for row in rows)
    assert by_classes[:2] == ["logarithms", "within-class"]
    assert min(float(cell) for cell in by_classes[2:]) > 0.95


def test_without_the_sets_of_shrec14_people_are_simulated(tmp_path: Path) -> None:
    clean, scans = (track(name, tmp_path / "data", tmp_path, 2) for name in ("synthetic", "real"))
    assert clean.title == "2 clean meshes of simulated people"
    assert clean.labels == {"person0_stand.off": "person0", "person9_arms_crossed.off": "person9"}
    assert clean.options.surface.mode == "keep"
    assert scans.title == "2 scans of simulated people, reconstructed"
    assert isinstance(read_scan(scans.folder / "person0_stand.ply"), PointCloud)


def test_tables_of_retrieval_have_every_system_and_a_page(two_sets: Path) -> None:
    folder = two_sets / "out"
    main(["--data", str(two_sets), "--output", str(folder), "--only", "table4", "--only", "figure5"])
    page = (folder / "paper.html").read_text("utf-8")
    systems = [line for line in page.splitlines() if re.search(r" (linear|cubic) +(d1|d2|log) ", line)]
    assert len(systems) == 16
    # Values by area, and the descriptors of the default, tell lengths of 1.5 and 3 apart without an error.
    assert all(line.endswith(" 1.000") for line in systems[-2:])
    assert "R-BiHDM-L23" in page
    assert "(0.976)" in page  # first tier in the paper
    assert '<img src="figure3b.png"' in page
    curves = (folder / "figure3b.csv").read_text("utf-8").splitlines()
    assert curves[0].startswith("recall,Shape-DNA,SD-GDM,")
    assert len(curves) == 1 + 21
    clean = next(line for line in page.splitlines() if line.startswith("r-bihdm     relative"))
    assert clean.split()[2:4] == ["1.00", "1.00"]
