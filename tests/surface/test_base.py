"""Bodies whose base was not seen, because they stood on it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapes

from pcretrieve import process, reconstruct
from pcretrieve.values import PointCloud

BUNNY = Path(__file__).parents[3] / "shared" / "data" / "stanford_bunny"

# Poses of the views of the bunny, as `pcretrieve merge` finds them. The first six are those of a turntable.
POSES = """
bmesh bun000.ply 0.000000 -0.000000 0.000000 -0.000000 0.000000 -0.000000 1.000000
bmesh bun045.ply -0.052104 -0.000338 -0.010831 0.005949 -0.294466 -0.002824 0.955639
bmesh bun090.ply -0.000088 -0.000096 -0.000063 0.000014 -0.707459 0.002584 0.706750
bmesh bun180.ply -0.000318 -0.000048 -0.000071 -0.000156 -0.999993 0.003489 -0.001104
bmesh bun270.ply -0.000340 -0.000184 0.000238 0.001737 0.706674 -0.002695 0.707532
bmesh bun315.ply -0.006535 -0.000032 -0.012871 0.004744 0.384425 -0.009884 0.923091
bmesh chin.ply 0.004583 0.088152 -0.108846 -0.441111 0.213503 0.005798 0.871667
bmesh ear_back.ply -0.083198 0.035951 0.071020 -0.114076 -0.925016 0.218066 0.289448
bmesh top2.ply -0.052841 0.138976 0.098617 -0.909157 0.058787 -0.155284 -0.381922
bmesh top3.ply -0.027678 0.058428 -0.079826 -0.060074 -0.670925 -0.679573 0.290571
"""
COARSE = {"surface": {"cell": 0.01, "target_faces": 3000, "reconstructions": 1}}


def test_an_unseen_base_is_closed_flat() -> None:
    """The ellipsoid x² / .36 + y² / .49 + z² = 1 above z = −.6."""
    points = shapes.points_on(shapes.ellipsoid((0.6, 0.7, 1.0)), 20_000)
    above = points[points[:, 2] > -0.6]
    surface = reconstruct(PointCloud(above, viewpoints=5 * above), COARSE)
    volume = np.pi * 0.6 * 0.7 * (1.6 - (1 + 0.6**3) / 3)
    assert surface.volume == pytest.approx(volume, rel=0.02)


@pytest.mark.skipif(
    not BUNNY.is_dir(), reason="needs the Stanford bunny beside the checkout, in ../shared/data"
)
def test_a_body_on_a_turntable_is_that_of_all_views(tmp_path: Path) -> None:
    """Through the unseen base, the flood fill enters the body, and contradicts the sensors."""
    for view in BUNNY.glob("*.ply"):
        (tmp_path / view.name).symlink_to(view)
    lines = POSES.strip().splitlines()
    made = []
    for name, chosen in (("turntable.conf", lines[:6]), ("all.conf", lines)):
        (tmp_path / name).write_text("\n".join(chosen))
        made.append(process(tmp_path / name, {"surface": {"reconstructions": 1}}))
    six, ten = made
    assert six.mesh.area == pytest.approx(ten.mesh.area, rel=0.03)
    assert six.mesh.volume == pytest.approx(ten.mesh.volume, rel=0.03)
    assert any("contradicted" in note for step in six.provenance for note in step.notes)
    assert not any("contradicted" in note for step in ten.provenance for note in step.notes)
