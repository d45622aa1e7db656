"""The figures of large catalogues are printed, and queries agree with brute force."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np

from pcretrieve.benchmarks.catalogue import OPTIONS
from pcretrieve.benchmarks.synthetic import CLASS_SIZE, synthetic_catalogue, synthetic_id
from pcretrieve.catalogue import Catalogue
from pcretrieve.evaluation import evaluate_table

SCRIPT = Path(__file__).parents[2] / "scripts" / "benchmark_catalogue"


def test_figures_of_catalogues_and_of_ingestion() -> None:
    command: list[str | Path] = [sys.executable, SCRIPT, "--shapes", "10000", "--meshes", "2"]
    command += ["--merged", "1000"]
    ended = subprocess.run(command, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    head, *lines = ended.stdout.splitlines()
    assert head.split() == ["figure", "measured"]
    measured = {line[:58].strip(): line[59:] for line in lines}
    assert re.fullmatch(r"[\d.]+ ms", measured["Catalogue(...)"])
    for distance in ("log", "d1", "d2"):
        for whitening in ("none", "pca", "within-class"):
            row = measured[f"index.nearest, {distance}, whitening {whitening}"]
            assert re.match(r"[\d.]+ ms; .*faiss.*; 5 of 5 as by brute force", row)
    assert re.fullmatch(
        r"median [\d.]+ s, peak \d+ MiB", measured["pcretrieve query ID, whose index is kept"]
    )
    assert re.fullmatch(
        r"[\d.]+ s in one transaction, [\d.]+ s one by one; removed in [\d.]+ s",
        measured["1,000 shapes more"],
    )
    assert re.fullmatch(r"[\d.]+ s", measured["10 parts of 100 shapes merged"])
    assert "shapes/s" in measured["pcretrieve ingest, 2 workers"]
    stored = measured["stored of a shape of two surfaces, beside its meshes"]
    assert float(stored.split()[0]) < 100


def test_a_synthetic_catalogue_is_one_like_any_other(tmp_path: Path) -> None:
    """Shapes of a class are alike, and the seed gives all of them."""
    tables = []
    for name in ("one", "two"):
        synthetic_catalogue(tmp_path / name, OPTIONS, 200, seed=3)
        with Catalogue(tmp_path / name, OPTIONS) as store:
            tables.append(store.signatures())
            record = store.record(synthetic_id(57))
    assert tables[0] == tables[1]
    assert record.label == f"class-{57 // CLASS_SIZE:06}"
    assert record.options_digest == OPTIONS.digest
    measures = evaluate_table(tables[0])
    assert measures.nn > 0.9
    assert np.unique(tables[0].values, axis=0).shape == (200, 45)


def test_sizes_that_are_no_classes_are_refused() -> None:
    command: list[str | Path] = [sys.executable, SCRIPT, "--shapes", "15"]
    ended = subprocess.run(command, capture_output=True, text=True)
    assert ended.returncode == 2
    assert "--shapes must be multiples of 10, got 15" in ended.stderr
