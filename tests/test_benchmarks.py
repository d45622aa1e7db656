"""The experiments of the paper find what is known, and every script of figures prints them."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import shapes
from benchmarks import simulation
from benchmarks.__main__ import BENCHMARKS
from benchmarks.bodies import Body
from benchmarks.breath import BUN_HIGHER, CHEST, HAIR, STYLED, breathing
from benchmarks.grades import add_ranks
from benchmarks.judging import metric_of_people, moments_of_people
from benchmarks.learning import GROUPS
from benchmarks.paper.shapes import drifts, noisy, perturbed, planar_mesh
from benchmarks.paper.spectra import (
    FIGURE_6,
    Element,
    convergence_rate,
    discrepancies,
    drum_spectra,
    drums,
    truncation_errors,
    unit_area_spectrum,
)
from benchmarks.people import POSES, joints
from benchmarks.recognition import (
    EVEN,
    SHARE_OF_HAIR,
    Scans,
    fused_points,
    haired,
    learned,
    limbless_moments,
    limbs_of,
    packed,
    reference,
)
from benchmarks.sensors import KINDS, MORE_POINTS, SENSORS, USUAL_POINTS, drawn, left_by
from benchmarks.transfer import (
    SensorScans,
    answers_of,
    found_by,
    lines_of_kinds,
    without,
)

from pcretrieve import ModalSpectrum, write_mesh
from pcretrieve.options import SignatureOptions
from pcretrieve.points.neighbors import nearest
from pcretrieve.retrieval import fit_whitening
from pcretrieve.retrieval.people import SYMMETRIC, installed, unpacked
from pcretrieve.values import FloatArray, TriangleMesh
from pcretrieve.values.topology import defects

SCRIPTS = Path(__file__).parents[1] / "scripts"


def printed(name: str, *arguments: object) -> str:
    command = [sys.executable, "-m", "benchmarks", name, *map(str, arguments)]
    ended = subprocess.run(command, capture_output=True, text=True, cwd=SCRIPTS)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


def test_every_benchmark_that_a_document_names_is_there() -> None:
    documents = [*SCRIPTS.parent.glob("*.md"), *(SCRIPTS.parent / "docs").rglob("*.md")]
    text = " ".join(path.read_text("utf-8") for path in documents)
    shown = re.findall(r"`scripts/benchmark\s([a-z_]+)([^`]*)`", text)
    assert {name for name, _ in shown} >= BENCHMARKS.keys() - {
        *(
            "house",
            "make_people",
            "make_scans",
            "sample",
        )  # which have scripts of their own
    }
    for name, words in shown:
        found = find_spec(f"benchmarks.{BENCHMARKS[name][0]}")
        assert found is not None and found.origin is not None, name
        source = Path(found.origin).read_text("utf-8")
        source += (SCRIPTS / "benchmarks" / "measuring.py").read_text("utf-8")
        assert [
            flag for flag in re.findall(r"--[a-z-]+", words) if f'"{flag}"' not in source
        ] == []


def test_a_benchmark_finds_its_environment(tmp_path: Path) -> None:
    """From another folder, without an active environment; here nothing is installed."""
    (tmp_path / "scripts").mkdir()
    for name in ("benchmark", "house"):
        shutil.copy(SCRIPTS / name, tmp_path / "scripts")
    (tmp_path / "scripts" / "setup").write_text("#!/bin/sh\n")
    (tmp_path / "scripts" / "setup").chmod(0o755)
    (tmp_path / "scripts" / "benchmarks").symlink_to(SCRIPTS / "benchmarks")
    (tmp_path / ".venv").symlink_to(sys.prefix)
    for words, printed_line in (
        (["benchmark"], "usage: scripts/benchmark NAME"),
        (["house", "--help"], "usage: benchmark house"),
    ):
        command = [str(tmp_path / "scripts" / words[0]), *words[1:]]
        ended = subprocess.run(
            command,
            cwd="/",
            env={"PATH": "/usr/bin:/bin"},
            capture_output=True,
            text=True,
        )
        assert ended.returncode == 0, ended.stderr
        assert ended.stdout.startswith(printed_line)


def test_drums_sound_alike_and_have_different_signatures_as_printed_in_figure_6() -> None:
    for drum in drums(16):
        assert (len(drum.vertices), drum.euler_characteristic) == (969, 1)
        assert defects(drum).boundary_edges == 9 * 16
    both: tuple[tuple[Element, int], ...] = (("linear", 16), ("cubic", 6))
    for element, n_cuts in both:
        columns = drum_spectra(element, n_cuts)
        np.testing.assert_allclose(columns[:, 0], columns[:, 1], rtol=1e-9)
        assert np.abs(columns[:, 3] / columns[:, 2] - 1).max() > 0.3
    sums = discrepancies(np.array([4.0, -1.0]), np.array([3.0, -1.5]), 0.5, 2.0)
    np.testing.assert_allclose(sums, [0.5, 0.75])
    # The meshes of the paper are other ones: its two columns of one spectrum differ by up to 3e-3.
    np.testing.assert_allclose(drum_spectra("linear"), FIGURE_6, rtol=5e-3)


def test_the_mesh_of_a_disk_has_the_spectrum_of_a_disk() -> None:
    y, x = np.mgrid[-120:121, -120:121] / 100
    mesh = planar_mesh(np.asarray(x**2 + y**2 <= 1, dtype=np.float64))
    assert mesh.area == pytest.approx(np.pi * 100**2, rel=0.01)
    # The squares of the zeros of the derivatives of the Bessel functions J₁ (twice), J₂ (twice) and J₀.
    expected = np.pi * np.array([1.841184, 1.841184, 3.054237, 3.054237, 3.831706]) ** 2
    np.testing.assert_allclose(
        unit_area_spectrum(mesh, 5).eigenvalues[1:], expected, rtol=0.01
    )


def test_on_the_sphere_the_error_is_that_of_the_tail_of_one_sum() -> None:
    """All harmonics of degree l: λ = 4π l (l + 1), each 2l + 1 times, and g is constant."""
    degrees = np.repeat(np.arange(25), 2 * np.arange(25) + 1)
    eigenvalues = (4 * np.pi * degrees * (degrees + 1)).astype(np.float64)
    spectrum = ModalSpectrum(eigenvalues, np.zeros((len(degrees), len(degrees))), 1.0)
    modes = tuple((degree + 1) ** 2 - 1 for degree in (6, 8, 10, 12, 14))
    errors = truncation_errors(spectrum, modes)
    terms = 2 / eigenvalues[1:] ** 2
    tails = np.array([terms[m:].sum() for m in modes])
    np.testing.assert_allclose(
        errors, tails**2 / ((terms.sum() - tails) * terms.sum()), rtol=1e-9
    )
    assert convergence_rate(modes, errors, len(terms)) == pytest.approx(2, abs=0.1)


def test_perturbations_do_what_their_names_say() -> None:
    sphere = shapes.icosphere(4)
    moved = noisy(sphere, 0.3, np.random.default_rng(0)).vertices - sphere.vertices
    radial = (moved * sphere.vertices).sum(axis=1)
    corners = sphere.vertices[sphere.faces]
    edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean()
    assert radial.std() == pytest.approx(0.3 * edge, rel=0.05)
    mesh = shapes.body(2)
    made = dict(perturbed(mesh, np.random.default_rng(0)))
    assert len(made["holes 3%"].faces) == pytest.approx(0.97 * len(mesh.faces), abs=5)
    assert len(made["half faces"].faces) == len(mesh.faces) // 2
    assert made["fTetWild"].area == pytest.approx(mesh.area, rel=0.05)


@pytest.mark.slow
def test_drift_is_nothing_for_the_same_pose_and_grows_with_noise() -> None:
    bodies = shapes.body(2), shapes.ellipsoid(subdivisions=2)
    same = {
        str(number): (mesh, shapes.moved(mesh, number, scale=3))
        for number, mesh in enumerate(bodies)
    }
    table = drifts(same, ("r-bihdm", "shape-dna"))
    assert table["pose"].max() < 1e-6
    assert (table["noise 0.1"] < table["noise 0.5"]).all()


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_every_script_prints_its_figures(tmp_path: Path) -> None:
    # Grouped folds need five classes; figure 7 takes cat0, david0 and horse0 of TOSCA.
    for name, lengths in (("shrec11", (1.5, 2.1, 3.0, 4.2, 6.0)), ("tosca", (1.5, 3.0))):
        (tmp_path / name).mkdir()
        rows = ["file,class"]
        for label, length in enumerate(lengths):
            for number, file in enumerate(("cat", "david", "horse")):
                mesh = shapes.ellipsoid((1, 1.2 + 0.03 * number, length), subdivisions=3)
                write_mesh(mesh, tmp_path / name / f"{file}{label}.off")
                rows.append(f"{file}{label}.off,long{label}")
        (tmp_path / name / "labels.csv").write_text("\n".join(rows))
    parts = [
        word
        for part in ("figure1", "figure6", "table4", "figure7")
        for word in ("--only", part)
    ]
    paper = printed("paper", "--data", tmp_path, "--output", tmp_path / "out", *parts)
    assert "Figure 6, drums of 969 and 969 vertices" in paper
    page = (tmp_path / "out" / "paper.html").read_text("utf-8")
    assert "Figure 1: 15 meshes of shrec11, of 5 classes" in page
    systems = [
        line
        for line in page.splitlines()
        if re.search(r" (linear|cubic) +(d1|d2|log) ", line)
    ]
    assert len(systems) == 16
    # Values by area tell lengths of 1.5 and 3 apart without an error; girths, which are alike, do not help.
    assert systems[-2].endswith(" 1.000") and float(systems[-1].split()[-1]) > 0.6
    assert re.search(r"median \d+\.\d{3} s", printed("spectral", "--part", "signature"))
    squares = printed("spectral", "--part", "square")
    assert len(re.findall(r" order (5\.9|6\.0)\d\n", squares)) == 6
    assert [
        float(error) < 1e-5 for error in re.findall(r" 36 vertices  error (\S+)", squares)
    ] == [True] * 2
    searched = printed(
        "catalogue", "--shapes", "10000", "--meshes", "2", "--merged", "1000"
    )
    assert searched.count("5 of 5 as by brute force") >= 6
    assert "shrec11" in printed("retrieval", "--data", tmp_path, "--only", "shrec11")
    assert "cold command" in printed("speed", "--part", "command")
    assert "scans" in printed("batch", "--scans", "4", "--rounds", "1")
    small = ("--shapes", "100", "--clients", "2", "--seconds", "1", "--meshes", "400")
    served = printed("serve", *small)
    assert len(re.findall(r"^/.* ms +0$", served, re.MULTILINE)) == 9


@pytest.mark.parametrize("seed", range(2))
def test_a_hole_that_is_a_damage_is_larger_than_those_of_the_sensor(seed: int) -> None:
    # The diagonal of a ball is longer beside its length than that of any other body.
    ball = Body("ball", "ball", shapes.icosphere(4))
    rng = np.random.default_rng(seed)
    points = SENSORS["uniform"](ball, rng)
    pierced = points[left_by("hole", points, ball, rng)]
    whole, damaged = (
        nearest(each, ball.mesh.vertices, 1)[0].max() for each in (points, pierced)
    )
    assert whole < damaged


@pytest.mark.parametrize("kind", KINDS)
def test_a_sensor_that_is_drawn_measures_the_surface(kind: str) -> None:
    ball = shapes.icosphere(4)
    body = Body("ball", "ball", ball, {"crown": int(ball.vertices[:, 1].argmax())})
    counts = []
    for seed in range(2):
        points = drawn(kind, body, np.random.default_rng(seed))
        again = drawn(kind, body, np.random.default_rng(seed))
        assert (points == again).all()
        off = np.abs(np.linalg.norm(points, axis=1) - 1)
        # Ten times the usual noise; flying points and strays are few.
        assert (off < 0.03).mean() > 0.9
        counts.append(len(points))
    assert len(set(counts)) == len(counts)
    assert USUAL_POINTS[0] / 4 < min(counts) and max(counts) < 1.01 * MORE_POINTS[1]


def test_a_damaged_scan_by_a_drawn_sensor_has_fewer_points() -> None:
    body = Body("ball", "ball", shapes.icosphere(4))
    rng = np.random.default_rng(0)
    points = drawn("uniform", body, rng)
    assert left_by("whole", points, body, rng).all()
    assert 0.5 < left_by("side", points, body, rng).mean() < 0.6
    assert 0 < left_by("hole", points, body, rng).mean() < 1


@pytest.mark.parametrize("pose", POSES)
def test_wider_poses_bend_knees_and_elbows_one_way(pose: str) -> None:
    drawn_angles = {}
    for width in (1.0, 1.3):
        rng = np.random.default_rng(0)
        turns = [joints(pose, rng, width) for _ in range(60)]
        drawn_angles[width] = np.array([turn["spine01"].magnitude() for turn in turns])
        for side in "LR":
            assert all(turn[f"lowerleg01.{side}"].as_rotvec()[0] >= 0 for turn in turns)
    assert drawn_angles[1.3].std() > drawn_angles[1.0].std()


def scans_of_people(n_people: int, spread: float) -> Scans:
    """Scans of people by four kinds of sensors, the parts of whose coordinates differ by a spread."""
    rng = np.random.default_rng(0)
    person = np.repeat(np.arange(n_people), len(KINDS))
    parts = {
        name: rng.normal(0, spread, (len(person), length)) + person[:, np.newaxis]
        for name, length in (("hapt", 154), ("r-bihdm", 59), ("size", 1))
    }
    ids = [f"person-5-0_{n}_walk_{kind}_whole" for n in range(n_people) for kind in KINDS]
    return Scans(parts, person, np.array(ids))


def test_a_metric_learns_how_scans_scatter_and_what_people_differ_by() -> None:
    """Coordinates scatter by the variance 1, the size by 25; people differ by their number in all of them."""
    scans = scans_of_people(400, 1.0)
    scans.parts["hapt"] *= EVEN.ravel()
    scans.parts["size"][:, 0] += 4.9 * np.random.default_rng(1).normal(0, 1, 1600)
    found = learned(scans)
    even = np.concatenate([EVEN.ravel(), np.ones(60)])
    scale = np.outer(found["scale"] / even, found["scale"] / even)
    within = found["within"] * scale
    assert within[-1, -1] == pytest.approx(25, rel=0.1)
    # People differ so much by their girths that the least variance of these is larger.
    assert np.diag(within)[EVEN.size : -1] == pytest.approx(1, rel=0.2)
    between = (found["total"] - found["within"]) * scale
    assert between == pytest.approx(400**2 / 12, rel=0.05)


def test_what_distances_mean_is_learned_from_people_who_did_not_teach_the_metric() -> (
    None
):
    """Forty people teach 177 coordinates so little that their own scans seem too near to each other."""
    scans = scans_of_people(40, 1.0)
    known = reference(scans)
    points = metric_of_people(learned(scans)).apply(
        fused_points(scans.parts, SignatureOptions())
    )
    gaps = np.linalg.norm(points[:, np.newaxis] - points, axis=2)
    own = np.triu(scans.person[:, np.newaxis] == scans.person, k=1)
    assert np.median(known.same) > 1.3 * np.median(gaps[own])
    assert (np.diff(known.same) >= 0).all()
    assert (np.diff(known.apart) >= 0).all()


@pytest.fixture
def standing() -> TriangleMesh:
    """A simulated person who stands."""
    subject = simulation.make_subject("person", np.random.default_rng(0))
    return simulation.body(
        subject, simulation.POSES["person"]["stand"], np.random.default_rng(0)
    )


def levels(mesh: TriangleMesh) -> FloatArray:
    """(n,) heights of vertices, from 0 to 1."""
    heights = mesh.vertices[:, 1] - mesh.vertices[:, 1].min()
    return np.asarray(heights / heights.max())


def test_breath_and_hair_move_the_chest_and_the_scalp_outwards(
    standing: TriangleMesh,
) -> None:
    mesh, level = standing, levels(standing)
    plain = [Body(f"{name}_stand", name, mesh) for name in "ab"]
    one, other = (each.mesh for each in breathing(plain, 1))
    apart = np.linalg.norm(one.vertices - mesh.vertices, axis=1)
    assert apart[level < 0.5].max() < 1e-6
    assert 1e-4 < apart[(level > 0.6) & (level < 0.8)].max() < CHEST
    assert 1e-3 < apart[level > 0.9].max() < 3 * HAIR
    assert one.volume > mesh.volume
    assert np.abs(one.vertices - other.vertices).max() > 1e-3


def test_hair_in_styles_is_another_than_hair_that_teaches(
    standing: TriangleMesh,
) -> None:
    mesh, level = standing, levels(standing)
    plain = [Body(f"{number}_stand", "one", mesh) for number in range(12)]
    moved = [each.mesh for each in breathing(plain, 1, is_styled=True)]
    thickest = np.array(
        [
            np.linalg.norm(each.vertices - mesh.vertices, axis=1)[level > 0.85].max()
            for each in moved
        ]
    )
    # One of four styles is no hair; a bun is thicker than other hair.
    assert 0 < (thickest < 1e-4).sum() < 12
    assert STYLED[0] < thickest.max() < BUN_HIGHER * STYLED[1]


def test_breath_and_hair_teach_what_they_change(
    standing: TriangleMesh, tmp_path: Path
) -> None:
    names = ["a_stand.ply", "a_walk.ply"]
    for name in names:
        write_mesh(standing, tmp_path / name)
    rows = ["file,class", *(f"{name},a" for name in names)]
    (tmp_path / "labels.csv").write_text("\n".join(rows))
    found = haired(tmp_path)
    assert found.shape == (214, 214)
    # Two surfaces teach two directions; the last coordinate is the logarithm of the area.
    assert np.linalg.matrix_rank(found, tol=1e-9 * np.trace(found)) == 2
    assert 0 < found[-1, -1] < SHARE_OF_HAIR * 0.05**2


def test_one_command_learns_from_the_people_whom_the_package_names() -> None:
    scans = sum(group.people * group.poses for group in GROUPS)
    told = (
        f"{scans:,} scans of {sum(group.people for group in GROUPS):,} simulated people"
    )
    text = files("pcretrieve.retrieval").joinpath("people.txt").read_text("utf-8")
    assert told in text
    numbers = [
        (group.seed, group.first + number)
        for group in GROUPS
        for number in range(group.people)
    ]
    assert len(set(numbers)) == len(numbers)


def test_collections_of_one_scan_each_name_their_people_and_no_strangers() -> None:
    scans, rng = scans_of_people(60, 1.0), np.random.default_rng(2)
    for part in scans.parts.values():
        part += 10 * rng.normal(size=(60, part.shape[1]))[scans.person]
    points = fused_points(scans.parts, SignatureOptions())
    judged = SensorScans(points, np.zeros(len(points)), scans.person)
    moments = moments_of_people(learned(scans))
    known, others = reference(scans), points[:3] + 100.0
    answers = answers_of(judged, 10, 1, moments, known, others)
    assert answers == (1.0, 1.0, "0 of 120", "0 of 600", "0 of 36")
    # If two people are in truth one, the one in the collection is named for the other.
    first = scans.person // 2 * 2 * len(KINDS)
    twins = judged._replace(points=points[first + np.arange(len(points)) % len(KINDS)])
    named = answers_of(twins, 10, 1, moments, known, points)[3:]
    assert int(named[0].split()[0]) > 40
    # So are people of another model, if they are those in the collection.
    assert int(named[1].split()[0]) > 40


def test_the_directions_of_what_limbs_change_make_its_second_moment() -> None:
    changes = np.random.default_rng(0).normal(size=(10, 214))
    moment = changes.T @ changes
    limbs = limbs_of(moment)
    assert limbs.shape == (214, 12)
    np.testing.assert_allclose(limbs @ limbs.T, moment, atol=1e-9)


def test_scans_without_a_limb_have_moments_of_their_own() -> None:
    scans = scans_of_people(200, 1.0)
    damages = np.where(scans.person % 2, "limb", "whole")
    ids = np.char.replace(scans.ids, "whole", "") + damages
    found = limbless_moments(scans._replace(ids=ids), np.full(214, 2.0))
    assert found["limbless_mean"].shape == (23,)
    assert found["limbless_mean"] == pytest.approx(100 / 2, rel=0.01)
    # They scatter by 1 round the odd numbers up to 200.
    assert np.diag(found["limbless"]) == pytest.approx(200**2 / 12 / 4, rel=0.02)


def test_symmetric_matrices_are_stored_as_triangles() -> None:
    sample = installed()
    for name in SYMMETRIC:
        assert (sample[name] == sample[name].T).all()
    for name, array in unpacked(packed(sample)).items():
        np.testing.assert_array_equal(array, sample[name], err_msg=name)


def test_a_sensor_that_is_left_out_teaches_nothing() -> None:
    scans = scans_of_people(10, 0.5)
    for kinds, n_kinds in ((["uniform"], 3), (["turntable", "steps"], 2)):
        rest = without(scans, kinds, fold=0)
        # Two of ten people are in the fold.
        assert len(rest.person) == 8 * n_kinds == len(rest.ids)
        assert (np.bincount(rest.person) == n_kinds).all()
    assert not any("uniform" in name for name in without(scans, ["uniform"]).ids)


def test_kinds_and_damages_of_which_there_are_no_scans_have_no_row() -> None:
    lines = [*lines_of_kinds(scans_of_people(50, 0.1))]
    rows = [line.split()[0] for line in lines[2:]]
    assert rows == ["cameras", "uniform", "depth", "whole"]


def test_queries_are_compared_with_all_other_scans_or_those_by_other_sensors() -> None:
    # Two scans of one person, of which another person's by the second sensor is nearer to the first.
    points = np.array([[0.0], [2.0], [1.0], [9.0]])
    person, sensor = np.array([0, 0, 1, 1]), np.array(["a", "b", "b", "a"])
    metric = fit_whitening("none", points)
    every = np.ones(4, dtype=bool)
    among_all = found_by(metric, points, person, queries=every)
    assert among_all.right.tolist() == [False, False, False, False]
    assert sorted(among_all.same) == [2, 2, 8, 8]
    crossed = found_by(metric, points, person, queries=every, sensor=sensor)
    assert crossed.apart.tolist() == [1, 7, 1, 7]
    assert crossed.right.tolist() == [False, True, False, False]


def test_people_are_ranked_by_their_own_metric_whatever_else_there_is() -> None:
    rng = np.random.default_rng(0)
    mean = moments_of_people().mean
    rows = [
        {
            "kind": kind,
            "sensor": "nine",
            "damage": "whole",
            "label": label,
            "name": f"{label}{pose}",
            "pose": pose,
            "word": "good",
            "point": (mean + rng.normal(0, 0.1, len(mean))).tolist(),
        }
        for kind in ("people", "animals")
        for label in "abcd"
        for pose in (0, 1)
    ]
    alone = [dict(row) for row in rows if row["kind"] == "people"]
    add_ranks(alone)
    add_ranks(rows)
    assert [row["own"] for row in rows[:8]] == [row["own"] for row in alone]
