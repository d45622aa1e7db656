"""The rate of each executor is measured by a whole ingest."""

from __future__ import annotations

from pathlib import Path

import pytest
import shapes

from pcretrieve.benchmarks.batch import EXECUTORS, run_of
from pcretrieve.errors import BenchmarkError
from pcretrieve.formats import write_mesh

pytest.importorskip("distributed", reason="distributed is not installed (the extra cluster)")


@pytest.mark.parametrize("executor", EXECUTORS)
def test_every_executor_has_a_rate(tmp_path: Path, executor: str) -> None:
    for number in range(4):
        write_mesh(shapes.ellipsoid((1, 1, 1 + number), subdivisions=2), tmp_path / f"{number}.off")
    run = run_of(executor, tmp_path)
    assert run.rate > 0
    assert run.first > 0


def test_scans_that_fail_have_no_rate(tmp_path: Path) -> None:
    write_mesh(shapes.ellipsoid((1, 1, 2), subdivisions=2), tmp_path / "a.off")
    (tmp_path / "b.off").write_text("OFF")
    with pytest.raises(BenchmarkError, match="1 failed"):
        run_of(EXECUTORS[1], tmp_path)
