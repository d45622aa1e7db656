"""Table 2: meshes of exactly so many vertices, and times that are measured."""

from __future__ import annotations

import time

import pytest
import shapes

from pcretrieve.benchmarks.paper import table_2
from pcretrieve.surface import defects


@pytest.mark.parametrize("size", [502, 9002])
def test_persons_have_so_many_vertices(size: int) -> None:
    """Simplified, and refined where the simulated person has fewer."""
    person = table_2._person(size)
    assert len(person.vertices) == size
    assert not defects(person).boundary_edges
    assert person.euler_characteristic == 2
    assert defects(person).components == 1
    assert person.area == pytest.approx(table_2._person(502).area, rel=0.05)


def test_refinement_divides_each_face_into_four() -> None:
    egg = shapes.ellipsoid((1, 1, 2), subdivisions=2)
    fine = table_2._refined(egg)
    assert len(fine.faces) == 4 * len(egg.faces)
    assert fine.area == pytest.approx(egg.area)
    assert fine.volume == pytest.approx(egg.volume)
    assert not defects(fine).boundary_edges


def test_each_kind_of_method_is_timed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table_2, "SIZES", {True: (402,), False: (402,)})
    methods: list[tuple[table_2.Kind, str]]
    methods = [("process", "spectrum"), ("descriptor", "wks"), ("matcher", "heat-hausdorff")]
    methods += [("matcher", "hks-bow-gallery")]  # which learns its words from the gallery
    for kind, method in methods:
        started = time.perf_counter()
        cost = table_2._cost(table_2.Task(kind, method, 502))
        assert 0 < cost.shape < time.perf_counter() - started
        assert (cost.pair is None) == (kind != "matcher")
    # Times below a millisecond say nothing about growth.
    assert table_2._growth({1000: 0.0001, 2000: 1.0, 4000: 4.0}) == pytest.approx(2)
    assert table_2._growth({1000: 0.0001, 2000: 1.0}) is None
