"""Columns line up, and what was not measured is a dash."""

from __future__ import annotations

import pytest

from pcretrieve.benchmarks.tables import Column, Table


def test_cells_stand_below_their_titles() -> None:
    table = Table(Column("name", 6, align="<"), Column("error", 8, ".1e"), Column("n", 4))
    assert table.head == "name      error    n"
    assert table.row("cat0", 0.00012, 10) == "cat0    1.2e-04   10"


def test_what_was_not_measured_is_a_dash() -> None:
    table = Table(Column("a", 4, ".2f"), Column("b", 4, ".2f"), Column("c", 4, "d"))
    assert table.row(float("nan"), None, 0) == "   -    -    0"


def test_a_row_must_have_every_column() -> None:
    with pytest.raises(ValueError, match="zip"):
        Table(Column("a", 4), Column("b", 4)).row(1)
