"""The benchmark of very fine meshes compares signatures and rankings of the same meshes."""

from __future__ import annotations

from pathlib import Path

import pytest
import shapes

from pcretrieve.benchmarks import large_meshes
from pcretrieve.formats import write_mesh


def test_what_simplification_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of meshes of 80 faces, refined to 1,280 and 5,120."""
    (tmp_path / "tosca").mkdir()
    lines = ["name,label"]
    for number in range(4):
        label = "longer"[: 4 + 2 * (number // 2)]
        write_mesh(
            shapes.ellipsoid((1, 1 + number % 2 / 9, 1.5 + number // 2), subdivisions=1),
            tmp_path / "tosca" / f"{number}.off",
        )
        lines.append(f"{number}.off,{label}")
    (tmp_path / "tosca" / "labels.csv").write_text("\n".join(lines))
    monkeypatch.setattr(large_meshes, "LIMITS", (4000, 2000))
    monkeypatch.setattr(large_meshes, "RETRIEVED", (large_meshes.NONE, 600))
    large_meshes.main(["--faces", "--data", str(tmp_path)])
    printed = [line.split() for line in capsys.readouterr().out.splitlines()]
    drifts = [words for words in printed if words[:1] in (["0"], ["2"])]
    assert [words[1:3] for words in drifts] == [["5,120", "4,000"], ["5,120", "2,000"]] * 2
    first, second, *_ = (float(words[3]) for words in drifts)
    assert 0 < first < second
    assert [(words[0], len(words)) for words in printed[-2:]] == [("none", 3), ("600", 3)]


def test_what_a_mesh_costs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    large_meshes.main(["--faces", "2000", "--data", str(tmp_path)])
    *costs, last = capsys.readouterr().out.splitlines()[1:]
    assert [line.split()[:2] for line in costs] == [["2,000", "none"], ["2,000", "200,000"]]
    assert all(float(line.split()[-1]) > 100 for line in costs)  # of a process with numpy and scipy
    assert "left out" in last
