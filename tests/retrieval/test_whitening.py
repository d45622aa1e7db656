"""Whitening: variances after it, invariants of it, and invalid arguments."""

import io
from typing import Any

import numpy as np
import pytest

from pcretrieve.errors import InputError, OptionError
from pcretrieve.evaluation import evaluate_table
from pcretrieve.options import RetrievalOptions
from pcretrieve.retrieval import DEFAULT_SHRINKAGE, Whitening, fit_whitening, pairwise
from pcretrieve.retrieval.covariances import shrunk
from pcretrieve.retrieval.pairs import neighbour_pairs
from pcretrieve.retrieval.regularisation import inverse_square_root
from pcretrieve.values import FloatArray, Metric, SignatureTable

FITTED = ("neighbours", "pca", "within-class")


def labelled_logs(*, seed: int = 0, n_classes: int = 12, per_class: int = 10) -> tuple[FloatArray, list[str]]:
    """(n, 8) log-signatures with different covariances within and between classes, and their classes."""
    rng = np.random.default_rng(seed)
    centres = rng.normal(size=(n_classes, 8)) * np.geomspace(2, 0.1, 8)
    within = rng.normal(size=(n_classes * per_class, 8)) * np.geomspace(0.02, 0.5, 8)
    mixing = rng.normal(size=(8, 8))
    labels = [f"class {number}" for number in range(n_classes) for _ in range(per_class)]
    return (np.repeat(centres, per_class, axis=0) + within) @ mixing, labels


def mean_average_precision(points: FloatArray, labels: list[str]) -> float:
    ids = tuple(f"{row:04}" for row in range(len(points)))
    table = SignatureTable(ids, np.exp(points), "x", labels=tuple(labels))
    return evaluate_table(table, RetrievalOptions(whitening="none")).map


def within_class_covariance(logs: FloatArray, labels: list[str]) -> FloatArray:
    names = np.array(labels)
    residuals = logs.copy()
    for name in set(labels):
        residuals[names == name] -= logs[names == name].mean(axis=0)
    covariance: FloatArray = residuals.T @ residuals / (len(logs) - len(set(labels)))
    return covariance


@pytest.mark.parametrize("kind", ("none", *FITTED))
def test_total_variance_is_unchanged(kind: str) -> None:
    logs, labels = labelled_logs()
    whitened = fit_whitening(kind, logs, labels).apply(logs)
    assert whitened.var(axis=0).sum() == pytest.approx(logs.var(axis=0).sum(), rel=1e-12)


def test_none_is_the_identity() -> None:
    logs, _ = labelled_logs()
    whitening = fit_whitening("none", logs)
    assert (whitening.apply(logs) == logs).all()
    assert (whitening.matrix == np.eye(8)).all()


def test_pca_with_hardly_any_shrinkage_makes_all_directions_equal() -> None:
    logs, _ = labelled_logs()
    covariance = np.cov(fit_whitening("pca", logs, shrinkage=1e-12).apply(logs).T)
    np.testing.assert_allclose(covariance, covariance[0, 0] * np.eye(8), atol=1e-6 * covariance[0, 0])


def test_pca_damps_each_variance_by_a_fraction_of_the_largest() -> None:
    logs, _ = labelled_logs()
    variances = np.linalg.eigvalsh(np.cov(logs.T))
    whitened = np.linalg.eigvalsh(np.cov(fit_whitening("pca", logs, shrinkage=0.05).apply(logs).T))
    expected = variances / (variances + 0.05 * variances[-1])
    np.testing.assert_allclose(whitened / whitened[-1], expected / expected[-1], rtol=1e-10)


def test_within_class_makes_spread_within_classes_equal() -> None:
    logs, labels = labelled_logs()
    whitened = fit_whitening("within-class", logs, labels, shrinkage=1e-12).apply(logs)
    covariance = within_class_covariance(whitened, labels)
    np.testing.assert_allclose(covariance, covariance[0, 0] * np.eye(8), atol=1e-6 * covariance[0, 0])


def test_within_class_shrunk_all_the_way_keeps_distances() -> None:
    logs, labels = labelled_logs()
    whitened = fit_whitening("within-class", logs, labels, shrinkage=1.0).apply(logs)
    np.testing.assert_allclose(pairwise("log", whitened, whitened), pairwise("log", logs, logs), atol=1e-12)


def test_within_class_shrinks_towards_the_mean_variance() -> None:
    logs, labels = labelled_logs()
    pooled = within_class_covariance(logs, labels)
    shrunk = 0.7 * pooled + 0.3 * np.trace(pooled) / 8 * np.eye(8)
    matrix = fit_whitening("within-class", logs, labels, shrinkage=0.3).matrix
    product = matrix @ shrunk @ matrix
    np.testing.assert_allclose(product, product[0, 0] * np.eye(8), atol=1e-10 * product[0, 0])


def test_within_class_of_values_with_different_units_does_not_depend_on_the_units() -> None:
    logs, labels = labelled_logs()
    units = np.geomspace(0.1, 10, 8)

    def gaps(points: FloatArray, metric: Metric) -> FloatArray:
        whitening = fit_whitening("within-class", points, labels, metric=metric)
        d = pairwise("log", *(whitening.apply(points),) * 2)
        relative: FloatArray = d / d.mean()
        return relative

    np.testing.assert_allclose(gaps(logs, "values"), gaps(logs * units, "values"), rtol=1e-6)
    assert np.abs(gaps(logs, "logarithms") - gaps(logs * units, "logarithms")).max() > 0.1


def test_a_value_that_is_the_same_in_every_class_does_not_prevent_a_fit() -> None:
    logs, labels = labelled_logs()
    constant = np.column_stack([logs, np.ones(len(logs))])
    whitened = fit_whitening("within-class", constant, labels, metric="values").apply(constant)
    assert np.isfinite(whitened).all()


def test_within_class_whitening_separates_classes_that_overlap_by_pose() -> None:
    logs, labels = labelled_logs()
    same = np.equal.outer(labels, labels)

    def contrast(points: FloatArray) -> float:
        d = pairwise("log", points, points)
        return float(d[~same].mean() / d[same].mean())

    assert contrast(fit_whitening("within-class", logs, labels).apply(logs)) > 2 * contrast(logs)


def test_unlabelled_shapes_and_classes_of_one_are_ignored() -> None:
    logs, labels = labelled_logs()
    strangers = 100 + np.random.default_rng(1).normal(size=(3, 8))
    alone = fit_whitening("within-class", logs, labels)
    among = fit_whitening("within-class", np.vstack([strangers, logs]), [None, "single", None, *labels])
    assert among.n_fitted == alone.n_fitted == len(logs)
    np.testing.assert_allclose(among.matrix, alone.matrix, rtol=1e-12)
    np.testing.assert_allclose(among.mean, alone.mean, rtol=1e-12)


def test_pca_does_not_look_at_labels() -> None:
    logs, labels = labelled_logs()
    assert (fit_whitening("pca", logs, labels).matrix == fit_whitening("pca", logs).matrix).all()


@pytest.mark.parametrize("kind", FITTED)
def test_the_matrix_is_symmetric_positive_definite(kind: str) -> None:
    logs, labels = labelled_logs()
    matrix = fit_whitening(kind, logs, labels).matrix
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-12)
    assert np.linalg.eigvalsh(matrix)[0] > 0


@pytest.mark.parametrize("kind", FITTED)
def test_distances_do_not_depend_on_the_order_of_shapes(kind: str) -> None:
    logs, labels = labelled_logs()
    order = np.random.default_rng(3).permutation(len(logs))
    shuffled = fit_whitening(kind, logs[order], [labels[i] for i in order])
    np.testing.assert_allclose(shuffled.matrix, fit_whitening(kind, logs, labels).matrix, rtol=1e-9)


@pytest.mark.parametrize("kind", ("none", *FITTED))
def test_a_row_does_not_depend_on_its_company(kind: str) -> None:
    logs, labels = labelled_logs()
    whitening = fit_whitening(kind, logs, labels)
    assert (whitening.apply(logs)[7] == whitening.apply(logs[7:8])[0]).all()


@pytest.mark.parametrize("kind", FITTED)
def test_fewer_shapes_than_values(kind: str) -> None:
    logs, _ = labelled_logs()
    few = logs[:3]
    whitening = fit_whitening(kind, few, ["a", "a", "a"])
    assert np.isfinite(whitening.matrix).all()
    assert whitening.apply(few).var(axis=0).sum() == pytest.approx(few.var(axis=0).sum())


@pytest.mark.parametrize("kind", ("none", *FITTED))
def test_arrays_keep_all_of_it_without_pickle(kind: str) -> None:
    logs, labels = labelled_logs()
    whitening = fit_whitening(kind, logs, labels, options_digest="3f2a")
    arrays: dict[str, Any] = whitening.to_arrays()
    file = io.BytesIO()
    np.savez(file, **arrays)
    file.seek(0)
    with np.load(file, allow_pickle=False) as stored:
        again = Whitening.from_arrays(stored)
    assert (again.apply(logs) == whitening.apply(logs)).all()
    for name in ("kind", "n_fitted", "shrinkage", "options_digest", "digest"):
        assert getattr(again, name) == getattr(whitening, name)


def test_the_digest_depends_on_kind_shrinkage_and_options() -> None:
    logs, labels = labelled_logs()
    base = fit_whitening("pca", logs, options_digest="3f2a")
    assert base.digest == fit_whitening("pca", logs[:50], options_digest="3f2a").digest
    others = [
        fit_whitening("within-class", logs, labels, options_digest="3f2a", shrinkage=base.shrinkage),
        fit_whitening("pca", logs, options_digest="3f2a", shrinkage=0.02),
        fit_whitening("pca", logs, options_digest="77b1"),
    ]
    assert len({base.digest, *(other.digest for other in others)}) == 4


@pytest.mark.parametrize("kind", ["neighbours", "pca"])
def test_the_default_shrinkage_is_recorded(kind: str) -> None:
    logs, labels = labelled_logs()
    assert fit_whitening(kind, logs, labels).shrinkage == DEFAULT_SHRINKAGE[kind]


def test_a_whitening_is_locked() -> None:
    whitening = fit_whitening("none", np.zeros((2, 3)))
    with pytest.raises(ValueError, match="read-only"):
        whitening.matrix[0, 0] = 2


def test_unknown_kind() -> None:
    with pytest.raises(
        OptionError,
        match="whitening must be one of auto, none, resolution, neighbours, pca, within-class, got 'zca'",
    ):
        fit_whitening("zca", np.zeros((2, 3)))
    with pytest.raises(OptionError, match="whitening must be one of"):
        Whitening("zca", np.zeros(3), np.eye(3), 2)


@pytest.mark.parametrize("kind", FITTED)
@pytest.mark.parametrize("shrinkage", [0.0, -0.1, 1.5, np.nan])
def test_shrinkage_out_of_range(kind: str, shrinkage: float) -> None:
    logs, labels = labelled_logs()
    with pytest.raises(OptionError, match=rf"shrinkage must lie in \(0, 1\], got {shrinkage}"):
        fit_whitening(kind, logs, labels, shrinkage=shrinkage)


@pytest.mark.parametrize(
    "logs", [np.zeros((0, 3)), np.ones((1, 3)), np.ones((5, 3))], ids=["empty", "one", "all equal"]
)
def test_pca_of_fewer_than_two_distinct_shapes(logs: FloatArray) -> None:
    with pytest.raises(InputError, match=r"pca whitening needs at least 2 distinct shapes.*use the"):
        fit_whitening("pca", logs)
    assert (fit_whitening("none", logs).apply(logs) == logs).all()


def test_within_class_of_equal_shapes() -> None:
    with pytest.raises(InputError, match="within-class whitening needs at least 2 distinct shapes"):
        fit_whitening("within-class", np.ones((4, 3)), ["a", "a", "b", "b"])


def test_within_class_of_classes_without_spread() -> None:
    logs = np.repeat(np.eye(3), 2, axis=0)
    with pytest.raises(InputError, match="differ within their class, got equal signatures in every class"):
        fit_whitening("within-class", logs, ["a", "a", "b", "b", "c", "c"])


def test_within_class_of_classes_of_one() -> None:
    with pytest.raises(InputError, match="a class with at least 2 shapes, got 3 classes and none"):
        fit_whitening("within-class", np.eye(4), ["a", "b", "c", None])


@pytest.mark.parametrize(("labels", "given"), [(None, "none"), (["a", "a"], "2")])
def test_within_class_without_a_label_for_each(labels: list[str] | None, given: str) -> None:
    with pytest.raises(InputError, match=rf"one label per shape \(4\), got {given}"):
        fit_whitening("within-class", np.eye(4), labels)


@pytest.mark.parametrize("logs", [np.zeros(3), np.full((3, 2), np.nan)])
def test_logs_that_cannot_be_fitted(logs: FloatArray) -> None:
    with pytest.raises(InputError, match=r"must be finite and have shape \(N, L\)"):
        fit_whitening("pca", logs)


@pytest.mark.parametrize("kind", ("none", *FITTED))
def test_logs_of_another_length(kind: str) -> None:
    logs, labels = labelled_logs()
    with pytest.raises(InputError, match=r"must have shape \(N, 8\).*got \(120, 7\)"):
        fit_whitening(kind, logs, labels).apply(logs[:, :7])


def test_stored_arrays_that_are_not_all_there() -> None:
    arrays = fit_whitening("none", np.zeros((2, 3))).to_arrays()
    del arrays["matrix"], arrays["shrinkage"]
    with pytest.raises(InputError, match="missing: matrix, shrinkage; fit it again"):
        Whitening.from_arrays(arrays)


def test_stored_arrays_that_do_not_fit() -> None:
    arrays = fit_whitening("none", np.zeros((2, 3))).to_arrays()
    with pytest.raises(InputError, match=r"the matrix of a whitening must have shape \(3, 3\), got \(2, 2\)"):
        Whitening.from_arrays(arrays | {"matrix": np.eye(2)})
    with pytest.raises(InputError, match="must be finite"):
        Whitening.from_arrays(arrays | {"mean": np.full(3, np.nan)})


def test_auto_uses_labels_that_determine_the_covariance() -> None:
    logs, labels = labelled_logs()
    assert fit_whitening("auto", logs, labels).kind == "within-class"
    for unknown in (None, [None] * len(logs), [*labels[:40], *[None] * 80]):
        assert fit_whitening("auto", logs, unknown).kind == "neighbours"  # 0, 0 and 4 classes
    assert fit_whitening("auto", logs, labels).reason == "within-class: 12 classes of 120 shapes"
    sparse = [label if row % 10 < 2 else None for row, label in enumerate(labels)]
    assert fit_whitening("auto", logs, sparse).kind == "within-class"  # 12 classes of 2, rank 12
    wide = np.hstack([logs, logs])  # 16 values
    assert fit_whitening("auto", wide, sparse).kind == "neighbours"


def test_of_few_shapes_nothing_is_learned_from_neighbours() -> None:
    logs, _ = labelled_logs()
    few = fit_whitening("neighbours", logs[:23])
    assert (few.kind, few.reason) == (
        "none",
        "none, because 23 shapes are too few to learn from neighbours (24)",
    )
    assert (few.apply(logs) == logs).all()
    equal = fit_whitening("neighbours", np.ones((30, 3)))
    assert equal.kind == "none"
    assert "only 0 pairs of shapes are mutual neighbours" in equal.reason
    assert fit_whitening("neighbours", logs[:24]).kind == "neighbours"


def test_neighbours_separate_classes_that_overlap_by_pose_without_labels() -> None:
    logs, labels = labelled_logs(n_classes=30)
    plain = mean_average_precision(logs, labels)
    whitened = mean_average_precision(fit_whitening("neighbours", logs).apply(logs), labels)
    assert plain < 0.9
    assert whitened > plain + 0.05


def test_a_second_round_finds_pairs_among_whitened_shapes() -> None:
    logs, _ = labelled_logs(n_classes=30)
    first, second = (fit_whitening("neighbours", logs, rounds=rounds, shrinkage=0.1) for rounds in (1, 2))
    pairs = neighbour_pairs(first.apply(logs))
    differences = logs[pairs.first] - logs[pairs.second]
    covariance = (differences * pairs.weights[:, np.newaxis]).T @ differences
    expected = inverse_square_root(shrunk(covariance, 0.1))
    np.testing.assert_allclose(second.matrix / second.matrix[0, 0], expected / expected[0, 0], rtol=1e-6)
    assert not np.allclose(second.matrix, first.matrix, rtol=0.01)
    with pytest.raises(OptionError, match="rounds must be at least 1, got 0"):
        fit_whitening("neighbours", logs, rounds=0)


def test_a_prior_is_part_of_the_covariance_of_neighbours() -> None:
    """Directions that the prior says to ignore have a smaller weight."""
    logs, _ = labelled_logs()
    prior = np.zeros((8, 8))
    prior[3, 3] = 1
    with_prior = fit_whitening("neighbours", logs, prior=prior, shrinkage=0.1).matrix
    without = fit_whitening("neighbours", logs, shrinkage=0.1).matrix
    assert with_prior[3, 3] / np.trace(with_prior) < 0.9 * without[3, 3] / np.trace(without)


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
    one_kind = np.repeat(centres, 6, axis=0) + 0.1 * rng.normal(size=(72, 40))
    fit_whitening("pca", one_kind)
    assert "PCA whitening is likely to make rankings worse here" in caplog.text
    caplog.clear()
    many_kinds = np.repeat(5 * rng.normal(size=(12, 40)), 6, axis=0) + 0.1 * rng.normal(size=(72, 40))
    fit_whitening("pca", many_kinds)
    assert not caplog.text
