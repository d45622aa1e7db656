"""Each kind of damage does what it says, and nothing else."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from benchmarks.damage import DamageOptions, damaged
from shapes import icosphere

from pcretrieve.draw.open3d import RayScene
from pcretrieve.errors import InputError, OptionError
from pcretrieve.surface import defects
from pcretrieve.values import TriangleMesh

NOTHING = DamageOptions(
    n_holes=0, n_flipped=0, n_flaps=0, radius=0.1, duplicated_share=0.0, shell_radius=0.0, shell_depth=0.02
)


def damage(seed: int = 0, **options: Any) -> TriangleMesh:
    return damaged(icosphere(4), replace(NOTHING, **options), np.random.default_rng(seed))


def test_without_damage_the_mesh_is_whole() -> None:
    assert np.array_equal(damage().faces, icosphere(4).faces)
    assert np.array_equal(damage().vertices, icosphere(4).vertices)


def test_holes_are_open_and_as_wide_as_asked_for() -> None:
    whole, holed = icosphere(4), damage(n_holes=1)
    found = defects(holed)
    assert found.boundary_edges > 0
    assert found == replace(defects(whole), boundary_edges=found.boundary_edges)
    # A ball whose centre lies on the unit sphere cuts a cap of area π r² out of it.
    cap = np.pi * (NOTHING.radius * whole.diagonal) ** 2
    assert whole.area - holed.area == pytest.approx(cap, rel=0.1)


def test_flipped_patches_disagree_with_their_neighbors() -> None:
    whole, flipped = icosphere(4), damage(n_flipped=1)
    found = defects(flipped)
    assert found.inconsistent_edges > 0
    assert found == replace(defects(whole), inconsistent_edges=found.inconsistent_edges)
    turned = (flipped.faces != whole.faces).any(axis=1)
    assert np.array_equal(flipped.faces[turned], whole.faces[turned][:, ::-1])


def test_duplicates_are_faces_of_the_surface_half_of_them_turned() -> None:
    whole, doubled = icosphere(4), damage(duplicated_share=0.1)
    m = len(whole.faces)
    extra = doubled.faces[m:]
    assert len(extra) == round(0.1 * m)
    sides = {tuple(np.roll(face, k)) for face in whole.faces for k in range(3)}
    agreeing = sum(tuple(face) in sides for face in extra)
    assert agreeing == len(extra) // 2
    assert defects(doubled).degenerate_faces == len(extra)


def test_flaps_cut_through_the_surface() -> None:
    whole, flapped = icosphere(4), damage(n_flaps=1)
    assert defects(flapped).components == 2
    flap = flapped.vertices[len(whole.vertices) :]
    radii = np.linalg.norm(flap, axis=1)
    assert radii.min() < 0.99
    assert radii.max() > 1.01
    # It is the copy of a patch: its middle stays where it was, on the surface.
    assert np.linalg.norm(flap - flap.mean(axis=0), axis=1).max() < 1.3 * NOTHING.radius * whole.diagonal


def test_the_second_shell_lies_beneath_the_first() -> None:
    whole, lined = icosphere(4), damage(shell_radius=0.3)
    assert defects(lined).components == 2
    shell = lined.vertices[len(whole.vertices) :]
    depth = RayScene(whole.vertices, whole.faces).distance(shell) / whole.diagonal
    assert np.linalg.norm(shell, axis=1).max() < 1
    assert depth == pytest.approx(NOTHING.shell_depth, rel=0.05)


def test_the_default_has_every_defect_and_belongs_to_its_generator() -> None:
    one, same, other = (
        damaged(icosphere(5), DamageOptions(radius=0.05), np.random.default_rng(seed)) for seed in (1, 1, 2)
    )
    found = defects(one)
    assert min(found.boundary_edges, found.inconsistent_edges, found.degenerate_faces) > 0
    assert found.components == 1 + DamageOptions().n_flaps + 1
    assert np.array_equal(one.faces, same.faces)
    assert len(one.faces) != len(other.faces)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"n_holes": -1}, "n_holes must be at least 0, got -1"),
        ({"radius": float("nan")}, "radius must be at least 0, got nan"),
        ({"duplicated_share": 1.5}, "duplicated_share must be a share between 0 and 1, got 1.5"),
    ],
)
def test_options_out_of_range_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(OptionError, match=message):
        DamageOptions(**options)


def test_a_mesh_without_faces_is_refused() -> None:
    nothing = TriangleMesh(np.zeros((1, 3)), np.empty((0, 3), dtype=np.int32))
    with pytest.raises(InputError, match="must have faces to be damaged, got none"):
        damaged(nothing, DamageOptions(), np.random.default_rng(0))
