"""Whitening: variances after it, invariants of it, the pairs it is learned from, and invalid arguments."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from benchmarks.shipped import N_BODIES, log_eigenvalues
from shapes import body, points_on

import pcretrieve.retrieval
from pcretrieve import PipelineOptions
from pcretrieve.descriptors import describe, reduced_matrix
from pcretrieve.errors import InputError, OptionError
from pcretrieve.evaluation import evaluate_table
from pcretrieve.options import RetrievalOptions, SignatureOptions
from pcretrieve.pipeline.process import process
from pcretrieve.retrieval import (
    Whitening,
    fit_whitening,
    pairwise,
    read_whitening,
    resolution_whitening,
    write_whitening,
)
from pcretrieve.retrieval.fitting import N_MODES
from pcretrieve.retrieval.pairs import LARGEST, MOST_NEIGHBORS, N_NEIGHBORS, neighbour_pairs
from pcretrieve.values import FloatArray, Metric, SignatureTable

FITTED = ("neighbours", "pca", "within-class")
SAMPLE = np.load(Path(pcretrieve.retrieval.__file__).with_name("resolution.npy"))


def labelled_logs(*, seed: int = 0, n_classes: int = 12, per_class: int = 10) -> tuple[FloatArray, list[str]]:
    """(n, 8) log-signatures with different covariances within and between classes, and their classes."""
    rng = np.random.default_rng(seed)
    centres = rng.normal(size=(n_classes, 8)) * np.geomspace(2, 0.1, 8)
    within = rng.normal(size=(n_classes * per_class, 8)) * np.geomspace(0.02, 0.5, 8)
    mixing = rng.normal(size=(8, 8))
    labels = [f"class {number}" for number in range(n_classes) for _ in range(per_class)]
    return (np.repeat(centres, per_class, axis=0) + within) @ mixing, labels


def within_class_covariance(logs: FloatArray, labels: list[str]) -> FloatArray:
    names = np.array(labels)
    residuals = logs.copy()
    for name in set(labels):
        residuals[names == name] -= logs[names == name].mean(axis=0)
    covariance: FloatArray = residuals.T @ residuals / (len(logs) - len(set(labels)))
    return covariance


@pytest.mark.parametrize("kind", ("none", *FITTED))
def test_laws_of_every_whitening(kind: str, tmp_path: Path) -> None:
    """The total variance stays, the matrix is symmetric and positive, and no row depends on its company."""
    logs, labels = labelled_logs()
    whitening = fit_whitening(kind, logs, labels, options_digest="3f2a")
    whitened = whitening.apply(logs)
    assert whitened.var(axis=0).sum() == pytest.approx(logs.var(axis=0).sum(), rel=1e-12)
    np.testing.assert_allclose(whitening.matrix, whitening.matrix.T, atol=1e-12)
    assert np.linalg.eigvalsh(whitening.matrix)[0] > 0
    assert (whitened[7] == whitening.apply(logs[7:8])[0]).all()
    order = np.random.default_rng(3).permutation(len(logs))
    shuffled = fit_whitening(kind, logs[order], [labels[i] for i in order])
    np.testing.assert_allclose(shuffled.matrix, whitening.matrix, rtol=1e-9)
    write_whitening(whitening, tmp_path / "w.npz")
    again = read_whitening(tmp_path / "w.npz")
    assert (again.apply(logs) == whitened).all() or kind == "none"
    assert (again.kind, again.options_digest) == ("calibrated", "3f2a")
    assert Whitening.from_arrays(whitening.to_arrays()) == whitening
    few = fit_whitening(kind, logs[:3], ["a", "a", "a"])
    assert few.apply(logs[:3]).var(axis=0).sum() == pytest.approx(logs[:3].var(axis=0).sum())
    with pytest.raises(InputError, match=r"must have shape \(N, 8\).*got \(120, 7\)"):
        whitening.apply(logs[:, :7])
    with pytest.raises(ValueError, match="read-only"):
        whitening.matrix[0, 0] = 2


def test_pca_makes_directions_equal_and_damps_small_ones() -> None:
    logs, labels = labelled_logs()
    covariance = np.cov(fit_whitening("pca", logs, shrinkage=1e-12).apply(logs).T)
    np.testing.assert_allclose(covariance, covariance[0, 0] * np.eye(8), atol=1e-6 * covariance[0, 0])
    variances = np.linalg.eigvalsh(np.cov(logs.T))
    whitened = np.linalg.eigvalsh(np.cov(fit_whitening("pca", logs, shrinkage=0.05).apply(logs).T))
    expected = variances / (variances + 0.05 * variances[-1])
    np.testing.assert_allclose(whitened / whitened[-1], expected / expected[-1], rtol=1e-10)
    assert (fit_whitening("pca", logs, labels).matrix == fit_whitening("pca", logs).matrix).all()


def test_within_class_makes_spread_within_classes_equal() -> None:
    logs, labels = labelled_logs()
    whitened = fit_whitening("within-class", logs, labels, shrinkage=1e-12).apply(logs)
    covariance = within_class_covariance(whitened, labels)
    np.testing.assert_allclose(covariance, covariance[0, 0] * np.eye(8), atol=1e-6 * covariance[0, 0])
    kept = fit_whitening("within-class", logs, labels, shrinkage=1.0).apply(logs)
    np.testing.assert_allclose(pairwise("log", kept, kept), pairwise("log", logs, logs), atol=1e-12)
    pooled = within_class_covariance(logs, labels)
    matrix = fit_whitening("within-class", logs, labels, shrinkage=0.3).matrix
    product = matrix @ (0.7 * pooled + 0.3 * np.trace(pooled) / 8 * np.eye(8)) @ matrix
    np.testing.assert_allclose(product, product[0, 0] * np.eye(8), atol=1e-10 * product[0, 0])
    strangers = 100 + np.random.default_rng(1).normal(size=(3, 8))
    alone = fit_whitening("within-class", logs, labels)
    among = fit_whitening("within-class", np.vstack([strangers, logs]), [None, "single", None, *labels])
    assert among.n_fitted == alone.n_fitted == len(logs)
    np.testing.assert_allclose(among.matrix, alone.matrix, rtol=1e-12)


def test_values_with_different_units_do_not_depend_on_the_units() -> None:
    logs, labels = labelled_logs()
    units = np.geomspace(0.1, 10, 8)

    def gaps(points: FloatArray, metric: Metric) -> FloatArray:
        whitening = fit_whitening("within-class", points, labels, metric=metric)
        d = pairwise("log", *(whitening.apply(points),) * 2)
        relative: FloatArray = d / d.mean()
        return relative

    np.testing.assert_allclose(gaps(logs, "values"), gaps(logs * units, "values"), rtol=1e-6)
    assert np.abs(gaps(logs, "logarithms") - gaps(logs * units, "logarithms")).max() > 0.1
    constant = np.column_stack([logs, np.ones(len(logs))])
    assert np.isfinite(fit_whitening("within-class", constant, labels, metric="values").matrix).all()


def test_what_cannot_be_fitted() -> None:
    logs, labels = labelled_logs()
    with pytest.raises(OptionError, match=r"whitening must be one of auto, none, resolution, .*, got 'zca'"):
        fit_whitening("zca", np.zeros((2, 3)))
    with pytest.raises(OptionError, match="whitening must be one of"):
        Whitening("zca", np.zeros(3), np.eye(3), 2)
    for kind in FITTED:
        for shrinkage in (0.0, -0.1, 1.5, np.nan):
            with pytest.raises(OptionError, match=rf"shrinkage must lie in \(0, 1\], got {shrinkage}"):
                fit_whitening(kind, logs, labels, shrinkage=shrinkage)
    for equal in (np.zeros((0, 3)), np.ones((1, 3)), np.ones((5, 3))):
        with pytest.raises(InputError, match=r"pca whitening needs at least 2 distinct shapes.*use the"):
            fit_whitening("pca", equal)
    for wrong in (np.zeros(3), np.full((3, 2), np.nan)):
        with pytest.raises(InputError, match=r"must be finite and have shape \(N, L\)"):
            fit_whitening("pca", wrong)
    given: Sequence[str | None] | None
    for rows, given, message in (
        (np.ones((4, 3)), ["a", "a", "b", "b"], "within-class whitening needs at least 2 distinct shapes"),
        (np.repeat(np.eye(3), 2, axis=0), [*"aabbcc"], "got equal signatures in every class"),
        (np.eye(4), ["a", "b", "c", None], "a class with at least 2 shapes, got 3 classes and none"),
        (np.eye(4), None, r"one label per shape \(4\), got none"),
        (np.eye(4), ["a", "a"], r"one label per shape \(4\), got 2"),
    ):
        with pytest.raises(InputError, match=message):
            fit_whitening("within-class", rows, given)
    arrays = fit_whitening("none", np.zeros((2, 3))).to_arrays()
    with pytest.raises(InputError, match="missing: matrix, shrinkage; fit it again"):
        Whitening.from_arrays({n: a for n, a in arrays.items() if n not in ("matrix", "shrinkage")})
    with pytest.raises(InputError, match=r"the matrix of a whitening must have shape \(3, 3\), got \(2, 2\)"):
        Whitening.from_arrays(arrays | {"matrix": np.eye(2)})
    with pytest.raises(InputError, match="must be finite"):
        Whitening.from_arrays(arrays | {"mean": np.full(3, np.nan)})


def test_auto_uses_labels_that_determine_the_covariance() -> None:
    logs, labels = labelled_logs()
    assert fit_whitening("auto", logs, labels).reason == "within-class: 12 classes of 120 shapes"
    for unknown in (None, [None] * len(logs), [*labels[:40], *[None] * 80]):
        assert fit_whitening("auto", logs, unknown).kind == "neighbours"  # 0, 0 and 4 classes
    sparse = [label if row % 10 < 2 else None for row, label in enumerate(labels)]
    assert fit_whitening("auto", logs, sparse).kind == "within-class"  # 12 classes of 2, rank 12
    assert fit_whitening("auto", np.hstack([logs, logs]), sparse).kind == "neighbours"  # 16 values
    few = fit_whitening("neighbours", logs[:23])
    assert few.reason == "none, because 23 shapes are too few to learn from neighbours (24)"
    equal = fit_whitening("neighbours", np.ones((30, 3)))
    assert equal.kind == "none" and "only 0 pairs of shapes are mutual neighbours" in equal.reason


def test_classes_that_overlap_by_pose_are_separated() -> None:
    """By their labels, and without labels by what neighbours differ by; a prior takes part in the latter."""
    logs, labels = labelled_logs(n_classes=30)
    same = np.equal.outer(labels, labels)

    def contrast(points: FloatArray) -> float:
        d = pairwise("log", points, points)
        return float(d[~same].mean() / d[same].mean())

    def precision(points: FloatArray) -> float:
        ids = tuple(f"{row:04}" for row in range(len(points)))
        table = SignatureTable(ids, np.exp(points), "x", labels=tuple(labels))
        return evaluate_table(table, RetrievalOptions(whitening="none")).map

    assert contrast(fit_whitening("within-class", logs, labels).apply(logs)) > 2 * contrast(logs)
    plain = precision(logs)
    assert plain < 0.9
    assert precision(fit_whitening("neighbours", logs).apply(logs)) > plain + 0.05
    prior = np.zeros((8, 8))
    prior[3, 3] = 1
    matrices = [fit_whitening("neighbours", logs, prior=one, shrinkage=0.1).matrix for one in (prior, None)]
    ignored, counted = (matrix[3, 3] / np.trace(matrix) for matrix in matrices)
    assert ignored < 0.9 * counted


def test_shrinkage_within_classes_follows_the_number_of_shapes() -> None:
    """Few shapes determine a covariance badly, so that more shrinkage makes other classes likelier."""
    rng = np.random.default_rng(2)
    mixing = rng.normal(size=(40, 40)) * np.geomspace(1, 0.03, 40)

    def estimated(n_classes: int) -> float:
        labels = [f"class {row // 4}" for row in range(4 * n_classes)]
        logs = rng.normal(size=(4 * n_classes, 40)) @ mixing
        return fit_whitening("within-class", logs, labels).shrinkage

    assert estimated(10) > estimated(400)


def test_pca_warns_where_neighbours_become_distant(caplog: pytest.LogCaptureFixture) -> None:
    """Classes far apart in two of forty directions: PCA whitening turns the noise in the others up."""
    rng = np.random.default_rng(0)
    centres = rng.normal(size=(12, 40)) * np.r_[5, 5, np.zeros(38)]
    fit_whitening("pca", np.repeat(centres, 6, axis=0) + 0.1 * rng.normal(size=(72, 40)))
    assert "PCA whitening is likely to make rankings worse here" in caplog.text
    caplog.clear()
    fit_whitening(
        "pca", np.repeat(5 * rng.normal(size=(12, 40)), 6, axis=0) + 0.1 * rng.normal(size=(72, 40))
    )
    assert not caplog.text


# --- pairs of neighbours --------------------------------------------------------------------------------


def classes_of(size: int, n_classes: int, *, spread: float = 0.1) -> FloatArray:
    """Isolated classes of equal size in ten dimensions."""
    rng = np.random.default_rng(size)
    centres = rng.normal(size=(n_classes, 10))
    return np.repeat(centres, size, axis=0) + spread * rng.normal(size=(size * n_classes, 10))


def test_pairs_are_of_one_class() -> None:
    """The number of neighbours is the size of isolated classes less one; without classes none stands out."""
    for size in (3, 5, 10):
        pairs = neighbour_pairs(classes_of(size, 12))
        assert pairs.n_neighbors == size - 1
        np.testing.assert_array_equal(pairs.first // size, pairs.second // size)
        assert len(pairs.weights) == 12 * size * (size - 1) // 2
    assert neighbour_pairs(np.random.default_rng(0).normal(size=(200, 10))).n_neighbors == N_NEIGHBORS
    overlapping = neighbour_pairs(classes_of(10, 40, spread=0.35))
    same = overlapping.first // 10 == overlapping.second // 10
    assert 0.7 < same.mean() < 1
    assert overlapping.weights[~same].mean() < 0.7 * overlapping.weights[same].mean()
    large = neighbour_pairs(classes_of(5, LARGEST))  # 20,000 shapes, of which groups of near ones are taken
    assert 100 < len(large.weights) < LARGEST * MOST_NEIGHBORS
    assert (large.first // 5 == large.second // 5).mean() > 0.9


def test_copies_form_no_pairs_and_the_order_of_shapes_does_not_matter() -> None:
    logs = classes_of(5, 20, spread=0.4)
    logs[1] = logs[0]
    logs[6] = logs[5] + 1e-14
    order = np.random.default_rng(1).permutation(100)
    there, here = neighbour_pairs(logs[order]), neighbour_pairs(logs)
    found = {frozenset(pair) for pair in zip(here.first.tolist(), here.second.tolist(), strict=True)}
    first, second = order[there.first].tolist(), order[there.second].tolist()
    assert {frozenset(pair) for pair in zip(first, second, strict=True)} == found
    assert frozenset((0, 1)) not in found
    assert here.weights.max() / here.weights.min() < 1e10
    assert neighbour_pairs(np.ones((30, 3))).weights.size == 0


# --- resolution -----------------------------------------------------------------------------------------


def test_the_sample_is_what_its_script_measures_and_what_signatures_are() -> None:
    """Order and unit of a signature are those of the sample's columns."""
    made = log_eigenvalues("animal", 3)
    # Rounding on another machine may move a voxel from one side of the surface to the other.
    np.testing.assert_allclose(made, SAMPLE[:, N_BODIES + 3], rtol=0, atol=0.02)
    assert np.abs(made[0] - made[1]).max() > 0.02
    shape = process(points_on(body(), 6000), PipelineOptions().changed(surface={"reconstructions": 1}))
    logs = np.log(np.abs(np.linalg.eigvalsh(reduced_matrix(shape.spectrum, N_MODES))))
    values = describe(shape, SignatureOptions(method="r-bihdm", n_values=60)).values
    np.testing.assert_allclose(np.log(values), logs[:60], rtol=1e-12)
    relative = describe(shape, SignatureOptions(method="r-bihdm", n_values=60, scale="relative")).values
    np.testing.assert_allclose(np.log(relative), logs[:60] - logs[60], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("scale", ["area", "relative"])
def test_what_resolution_changes_counts_less(scale: str) -> None:
    for n_values in (1, 23, 60):
        options = SignatureOptions.model_validate({"method": "r-bihdm", "scale": scale, "n_values": n_values})
        whitening = resolution_whitening(options)
        logs = SAMPLE[:, :, :60] - (SAMPLE[:, :, 60:] if scale == "relative" else 0)
        change = (logs[0] - logs[1])[:, :n_values].astype(np.float64)
        size = np.linalg.norm(change, axis=1)
        change = change[np.argsort(size)][: whitening.n_fitted]
        anything = np.random.default_rng(0).normal(size=(4000, n_values))
        shares = [((each @ whitening.matrix) ** 2).sum() / (each**2).sum() for each in (anything, change)]
        assert shares[0] == pytest.approx(1, rel=0.1)
        assert shares[1] < 0.5 or n_values == 1
        assert 0.8 * len(size) < whitening.n_fitted < 0.9 * len(size)


def test_a_size_stays_what_it_is_and_other_signatures_were_not_measured() -> None:
    logs = np.random.default_rng(0).normal(size=(5, SignatureOptions().n_values + 1))
    form = resolution_whitening(SignatureOptions(method="r-bihdm")).apply(logs[:, :-1])
    sized = resolution_whitening(SignatureOptions(method="r-bihdm", size_weight=6)).apply(logs)
    np.testing.assert_allclose(sized, np.column_stack([form, logs[:, -1]]), rtol=1e-12)
    for given in (
        {},
        {"method": "shape-dna"},
        {"method": "r-bihdm", "n_modes": 50},
        {"method": "r-bihdm", "scale": "absolute"},
    ):
        with pytest.raises(OptionError, match="'resolution' has been measured for r-bihdm with n_modes = 60"):
            resolution_whitening(SignatureOptions.model_validate(given))
    with pytest.raises(OptionError, match=r"shrinkage must lie in \(0, 1\], got 0"):
        resolution_whitening(SignatureOptions(method="r-bihdm"), shrinkage=0)
