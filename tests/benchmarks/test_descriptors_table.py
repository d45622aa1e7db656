"""The table of descriptors and matchers has all rows, and says what it leaves out."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import shapes

from pcretrieve.formats import write_mesh

SCRIPT = Path(__file__).parents[2] / "scripts" / "benchmark_descriptors"


def test_a_set_of_five_classes(tmp_path: Path) -> None:
    folder = tmp_path / "tosca"
    folder.mkdir()
    lines = ["file,class"]
    for number in range(5):
        for copy in range(2):
            egg = shapes.ellipsoid((1, 1, 1 + number / 2), subdivisions=3)
            name = f"egg{number}{copy}.off"
            write_mesh(shapes.moved(egg, copy), folder / name)
            lines.append(f"{name},kind{number}")
    (folder / "labels.csv").write_text("\n".join(lines))
    ended = subprocess.run(
        [
            *(sys.executable, SCRIPT, "--data", tmp_path, "--n-values", "9", "99"),
            *("--methods", "wks", "r-bihdm", "hks-bow", "heat-hausdorff"),
        ],
        capture_output=True,
        text=True,
    )
    assert ended.returncode == 0, ended.stderr
    head, missing, *rows = ended.stdout.splitlines()
    assert head.split()[:6] == ["set", "method", "L", "scale", "distance", "whitening"]
    assert missing.startswith("shrec11: left out, ")
    assert "left out: n_values must be between 2 and 90" in rows.pop()
    longer = [row for row in rows if "left out: n_values must be between 1 and n_modes = 60" in row]
    assert [row.split()[1:4] for row in longer] == [["r-bihdm", "99", s] for s in ("relative", "area")]
    rows = [row for row in rows if row not in longer]
    matched = rows.pop(0).split()
    assert matched[:6] == ["tosca", "heat-hausdorff", "-", "-", "-", "-"]
    assert float(matched[6]) == 1, "the moved copy of each egg is its nearest neighbour"
    assert float(matched[-2]) > 0 and matched[-1] == "0"
    assert len(rows) == 5 * 12 + 2 * 3, "wks at two lengths, r-bihdm by two scales, hks-bow once"
    assert sum(row.split()[5] == "resolution" for row in rows) == 2 * 3, "r-bihdm only"
    figures = np.array([[*row.split()[6:-2], row.split()[-1]] for row in rows], dtype=float)
    plain = [row.split()[5] == "none" for row in rows]
    assert (figures[plain, 0] == 1).all(), "the moved copy of each egg is its nearest neighbour"
    assert (figures[:, -1] == 0).all(), "nothing failed"
