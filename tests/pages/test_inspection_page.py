"""The page of one scan: its pictures show what is wrong, its viewer what it is told; nothing breaks it."""

from __future__ import annotations

import json
import re
from base64 import b64decode
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import shapes
from benchmarks.simulation import POSES, body, make_subject
from numpy.typing import NDArray

from pcretrieve.checks import Check, Inspection, graded
from pcretrieve.checks.grading import MEASURES
from pcretrieve.checks.stages import surface_checks
from pcretrieve.draw.pictures import Colour
from pcretrieve.pages.inspection_page import inspection_html
from pcretrieve.pages.inspection_pictures import (
    DROPPED,
    KEPT,
    inspection_cameras,
    rows_of,
)
from pcretrieve.pages.scene import measures, thicker
from pcretrieve.values import Failure, PointCloud, Signature

SPHERE = shapes.icosphere(5)
OUTLIERS = np.array([[1.15, 0.1, 0.1], [0.2, -1.2, 0.3]])


def inspection() -> Inspection:
    """A sphere with its upper half filled in, a cut at its top, and two outliers."""
    points = SPHERE.vertices[np.argsort(SPHERE.vertices[:, 0])]
    mesh = shapes.icosphere(3)
    return Inspection(
        name="ball.ply",
        path="scans/ball.ply",
        checks=(
            Check("Outliers", "look", 0.05, "5 % dropped", "Look."),
            Check("Points", "passed", 1.0, "many", "Fine."),
        ),
        scan=PointCloud(np.concatenate([points, OUTLIERS])),
        cut_away=np.zeros(len(points) + 2, dtype=bool),
        dropped=np.arange(len(points) + 2) >= len(points),
        cloud=PointCloud(points, points),
        spacing=0.035,
        mesh=mesh,
        filled=mesh.vertices[mesh.faces].mean(axis=1)[:, 2] > 0,
        cuts=np.array([[0.0, 0, 1]]),
        bridges=np.zeros((0, 3)),
        signature=Signature(np.geomspace(1, 0.01, 10), "r-bihdm"),
        rescan_errors=np.linspace(0.01, 0.1, 10),
        rescan_error=0.2,
        failure=None,
        steps=(),
    )


def has_colour(colour: Colour, pixels: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which of the opaque pixels have this colour, however dark; pixels at an edge do not count."""
    seen = pixels[pixels[..., 3] > 0.5][:, :3]
    directions = seen / np.maximum(np.linalg.norm(seen, axis=1, keepdims=True), 1e-9)
    found: NDArray[np.bool_] = (
        directions @ np.array(colour) / np.linalg.norm(colour) > 0.995
    )
    return found


# --- the page -----------------------------------------------------------------------------------------


def scene_of(page: bytes) -> dict[str, Any]:
    (found,) = re.findall(
        rb'<script type="application/json" id="scene">(.*?)</script>', page, re.DOTALL
    )
    return dict(json.loads(found))


def test_the_viewer_gets_points_normals_and_faces() -> None:
    seen = inspection()
    scene = scene_of(inspection_html(seen))
    layers = {layer["name"]: layer for layer in scene["layers"]}
    assert list(layers) == [
        "points",
        "dropped",
        "cut",
        "normals",
        "surface",
        "filled",
        "cuts",
        "bridges",
        "faults",
    ]

    def places(name: str) -> NDArray[np.float64]:
        grid = (
            np.frombuffer(b64decode(layers[name]["at"]), "<u2")
            .reshape(-1, 3)
            .astype(np.float64)
        )
        # Radius of the body: 1.
        places: NDArray[np.float64] = (2 * grid / (2**16 - 1) - 1) * scene["zoom"]
        return places

    assert (
        seen.cloud is not None
        and seen.cloud.normals is not None
        and seen.mesh is not None
    )
    np.testing.assert_allclose(places("normals"), seen.cloud.points, atol=1e-4)
    np.testing.assert_allclose(places("dropped"), OUTLIERS, atol=1e-4)
    np.testing.assert_allclose(places("cuts"), seen.cuts, atol=1e-4)
    np.testing.assert_allclose(places("surface"), seen.mesh.vertices, atol=1e-4)
    assert len(places("bridges")) == 0
    normals = np.frombuffer(b64decode(layers["normals"]["normal"]), np.int8).reshape(
        -1, 3
    )
    np.testing.assert_allclose(normals / 127, seen.cloud.normals, atol=0.005)
    faces = np.frombuffer(b64decode(layers["filled"]["faces"]), "<u4").reshape(-1, 3)
    np.testing.assert_array_equal(faces, seen.mesh.faces[seen.filled])


def test_outliers_far_away_do_not_shrink_the_body_and_are_at_the_edge() -> None:
    """Two outliers far to the right of the first camera, the only points beyond the body there."""
    plain = inspection()
    assert plain.scan is not None
    right = inspection_cameras(plain)[0].axes[0]
    away = PointCloud(
        np.concatenate([plain.scan.points[:-2], [1000 * right, 1001 * right]])
    )
    seen = replace(plain, scan=away)
    overview, body = rows_of(seen)[:2]
    assert overview.title.startswith("All points that were read, 2 of them at the edge")
    assert [words for _, words in body.key] == [
        f"{len(away.points) - 2:,} points",
        "2 dropped as outliers, 2 of them beyond an edge in some pictures",
    ]
    for before, after in zip(rows_of(plain)[0].pictures, body.pictures, strict=True):
        assert (
            abs(before.width - after.width) <= 1
            and abs(before.height - after.height) <= 40
        )
    first = np.asarray(overview.pictures[0], dtype=np.float64) / 255
    assert has_colour(KEPT, first).mean() > 0.5
    assert has_colour(DROPPED, first[:, -4:]).any()


def test_the_page_needs_nothing_else_stays_small_and_no_name_can_break_it() -> None:
    many = shapes.points_on(SPHERE, 300_000)
    nasty = "</script><script>alert(\"1\")</script> & ' onload='x"
    seen = replace(
        inspection(),
        name=nasty,
        path=nasty,
        checks=(Check(nasty, "look", None, nasty, nasty),),
        scan=PointCloud(many),
        cut_away=np.zeros(len(many), dtype=bool),
        dropped=np.arange(len(many)) % 2 == 0,
        cloud=PointCloud(many, many / np.linalg.norm(many, axis=1, keepdims=True)),
        mesh=SPHERE,
        filled=np.ones(len(SPHERE.faces), dtype=bool),
    )
    text = inspection_html(seen).decode()
    assert len(text) < 5e6
    assert "alert(&#34;1&#34;)" in text
    assert text.count("<script") == text.count("</script>") == 2
    assert "default-src 'none'" in text
    assert not re.findall(r"""(?:src|href)=["'](?!data:)|https?:|url\((?!data:)""", text)


def test_the_summary_says_what_is_wrong() -> None:
    seen = inspection()  # with a spread of .2
    error = "the error bar of its signature is ± 0.2."
    assert (seen.outcome, seen.summary) == (
        "passed",
        f"A good scan: {error} Look at: outliers.",
    )
    much = Check(
        "Noise", "look", 1.0, "much", "Hold still.", 1.5, says="the points scatter"
    )
    noisy = replace(seen, checks=(much, *seen.checks))
    assert noisy.outcome == "look"
    assert noisy.summary == (
        "A poor scan, may answer wrongly: the points scatter; "
        "the error bar of its signature is ± 1.5."
    )
    hole = Check(
        "Largest hole",
        "failed",
        1.0,
        "wide",
        "Scan it.",
        0.0,
        "incomplete",
        "a hole shows",
    )
    failed = replace(seen, checks=(hole, *seen.checks))
    assert failed.outcome == "look"
    assert (
        failed.summary == f"An incomplete scan, may answer wrongly: a hole shows; {error}"
    )
    stopped = replace(
        failed,
        signature=None,
        failure=Failure("b.ply", "surface", "ReconstructionError", "no"),
    )
    assert (
        stopped.summary
        == "No signature, the surface stage failed; look at: largest hole, outliers."
    )


def test_two_bodies_are_measured_and_compared() -> None:
    slim, stout = (
        shapes.ellipsoid((width, width, 2.0), subdivisions=3) for width in (1.0, 1.3)
    )
    assert (
        0.3 < np.median(thicker(stout, slim)) < 0.7
        and np.median(thicker(slim, slim)) == 0
    )
    ball = measures(SPHERE, np.array([0.0, 0, 1]))
    assert ball == pytest.approx(
        {"height": 2, "area": 4 * np.pi, "volume": 4 / 3 * np.pi}, rel=0.01
    )
    subject = make_subject("person", np.random.default_rng(3))
    stands, walks = (
        measures(body(subject, POSES["person"][pose]), None) for pose in ("stand", "walk")
    )
    for name, least in (
        ("head to foot", 1.5),
        ("waist", 0.6),
        ("thigh", 0.3),
        ("upper arm", 0.2),
    ):
        assert least < stands[name] < 2 * least and walks[name] == pytest.approx(
            stands[name], rel=0.1
        ), name


# --- the checks ---------------------------------------------------------------------------------------


def test_surfaces_are_distinguished() -> None:
    for mesh, outcomes in (
        (SPHERE, ["passed", "passed"]),
        (shapes.torus(), ["passed", "look"]),
        (shapes.square(3), ["look"]),
        (shapes.joined(SPHERE, shapes.moved(SPHERE, 1)), ["look"]),
    ):
        assert [check.outcome for check in surface_checks(mesh)] == outcomes


@pytest.mark.parametrize(
    "name", ["Points", "Filled in", "Gaps", "Left out", "Noise", "Surfaces"]
)
def test_worse_numbers_get_worse_outcomes(name: str) -> None:
    limits = MEASURES[name].limits
    assert limits is not None
    values = (0.0, sum(limits) / 2, 2 * limits[1])
    found = [graded(name, value, "").outcome for value in values]
    assert found == ["passed", "look", "failed"]


def test_a_place_of_a_failed_check_is_ringed_and_turned_to() -> None:
    place = (0.0, 0.0, 1.0)
    hole = Check(
        "Largest hole", "failed", 1.0, "wide", "", 0.0, "incomplete", "a hole", (place,)
    )
    seen = replace(
        inspection(), mesh=SPHERE, filled=np.zeros(len(SPHERE.faces), dtype=bool)
    )
    seen = replace(seen, checks=(hole,))
    assert seen.rings.tolist() == [[0, 0, 1]]
    text = inspection_html(seen).decode()
    assert re.search(
        r'<a href="#surface,filled,faults@-?\d+,-?\d+"[^>]*>Largest hole</a>', text
    )


def test_rescans_that_differ_more_get_worse_outcomes() -> None:
    spreads = [graded("Signature", spread, "").outcome for spread in (0.05, 0.3, 1)]
    assert spreads == ["passed", "look", "failed"]
