"""The table of whitenings and re-rankings has a row for each, and says what it leaves out."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import shapes
from scipy.io import savemat

from pcretrieve.catalogue import Catalogue
from pcretrieve.formats import write_mesh
from pcretrieve.ingestion.layouts import LAYOUTS

SCRIPT = Path(__file__).parents[2] / "scripts" / "benchmark_retrieval"


def printed(*arguments: object) -> list[str]:
    ended = subprocess.run(
        [sys.executable, SCRIPT, *map(str, arguments)], capture_output=True, text=True, timeout=200
    )
    assert ended.returncode == 0, ended.stderr
    return ended.stdout.splitlines()


def test_vectors_and_missing_sets(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    labels = np.repeat(np.arange(10), 6)
    values = rng.normal(size=(10, 150))[labels] + 0.4 * rng.normal(size=(60, 150))
    (tmp_path / "shrec14_csd").mkdir()
    arrays = {"WksPooledMat": values[:, :100], "SihksPooledMat": values[:, 100:], "C": labels}
    savemat(tmp_path / "shrec14_csd" / "real.mat", arrays)
    head, *rows, calibrated, spread, missing = printed(
        "--data", tmp_path, "--only", "shrec14-real", "shrec11"
    )
    assert head.split()[:5] == ["set", "method", "L", "whitening", "re-ranking"]
    assert [tuple(row.split()[3:5]) for row in rows] == [
        (whitening, method)
        for whitening in ("none", "pca", "neighbours", "within-class")
        for method in ("none", "local", "k-reciprocal")
    ]
    assert all(float(row.split()[-1]) > 0.9 for row in rows if "pca" not in row)
    assert calibrated.split()[3:5] == ["3-people", "none"]
    assert spread.split()[3:5] == ["3-people", "deviation"]
    assert float(calibrated.split()[-1]) > 0.9 > 0.1 > float(spread.split()[-1])
    published = f"the set is published at {LAYOUTS['shrec11'].published}"
    assert missing == f"shrec11: left out, {tmp_path / 'shrec11'} is not there; {published}"


def test_vectors_are_compared_by_their_logarithms_too(tmp_path: Path) -> None:
    """Classes that differ by factors, of values of very different sizes."""
    rng = np.random.default_rng(0)
    labels = np.repeat(np.arange(10), 6)
    logs = rng.normal(size=(10, 150))[labels] + 1.5 * rng.normal(size=(60, 150))
    values = np.exp(logs) * np.geomspace(1e-6, 1, 150)
    (tmp_path / "shrec14_csd").mkdir()
    arrays = {"WksPooledMat": values[:, :100], "SihksPooledMat": values[:, 100:], "C": labels}
    savemat(tmp_path / "shrec14_csd" / "real.mat", arrays)
    rows = printed("--data", tmp_path, "--only", "shrec14-real", "shrec14-real-log")[1:]
    plain = {row.split()[0]: float(row.split()[-1]) for row in rows if row.split()[3:5] == ["none", "none"]}
    assert plain["shrec14-real-log"] > plain["shrec14-real"] + 0.2


def test_catalogues_are_kept(tmp_path: Path) -> None:
    samples, kept = tmp_path / "samples", tmp_path / "kept"
    samples.mkdir()
    lines = ["file,class"]
    for number in range(5):
        for copy in range(2):
            egg = shapes.ellipsoid((1, 1, 1 + number / 2), subdivisions=3)
            write_mesh(shapes.moved(egg, copy), samples / f"egg{number}{copy}.off")
            lines.append(f"egg{number}{copy}.off,kind{number}")
    (samples / "labels.csv").write_text("\n".join(lines))
    asked = ("--only", "samples", "--samples", samples, "--keep", kept)
    first = printed(*asked)
    assert len(first) == 1 + 4 * 3
    with Catalogue(kept / "samples.sqlite") as catalogue:
        records = catalogue.records()
    assert printed(*asked) == first
    with Catalogue(kept / "samples.sqlite") as catalogue:
        assert catalogue.records() == records, "with the times at which they were processed"


def test_how_good_no_match_is(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    labels = np.repeat(np.arange(10), 6)
    values = rng.normal(size=(10, 150))[labels] + 0.05 * rng.normal(size=(60, 150))
    (tmp_path / "shrec14_csd").mkdir()
    arrays = {"WksPooledMat": values[:, :100], "SihksPooledMat": values[:, 100:], "C": labels}
    savemat(tmp_path / "shrec14_csd" / "real.mat", arrays)
    head, *rows = printed("--data", tmp_path, "--only", "shrec14-real", "--no-match")
    assert head.split()[-4:] == ["precision", "recall", "matched", "right"]
    assert [row.split()[1] for row in rows] == ["labels", "labels", "neighbours", "neighbours"]
    assert [row.split()[-5] for row in rows] == ["0.9", "0.5", "0.9", "0.5"]
    assert [row.split()[-4:] for row in rows[:2]] == [["1.000"] * 4] * 2
