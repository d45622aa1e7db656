"""Whitening: variances after it, invariants of it, the pairs it is learned from, and invalid arguments."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benchmarks.measuring import evaluate_table
from scipy.stats import multivariate_normal
from tables import classes_of, posed_logs, table_of

from pcretrieve.descriptors import DESCRIPTORS, signature_length
from pcretrieve.errors import InputError, OptionError
from pcretrieve.evaluation.measures import verification
from pcretrieve.options import RetrievalOptions, SignatureOptions
from pcretrieve.retrieval import (
    People,
    Whitening,
    fit_whitening,
    limbless_ratio,
    pairwise,
    people,
)
from pcretrieve.retrieval.people import installed
from pcretrieve.retrieval.whitening import (
    MOST_UNUSUAL,
    USUAL,
    calibrated_whitening,
    read_whitening,
    write_whitening,
)
from pcretrieve.values import FloatArray, Metric

FITTED = ("neighbours", "pca", "within-class")


def labelled_logs(
    n_classes: int = 12, per_class: int = 10
) -> tuple[FloatArray, list[str]]:
    """(n, 8) log-signatures with different covariances within and between classes, and their classes."""
    rng = np.random.default_rng(0)
    centres = rng.normal(size=(n_classes, 8)) * np.geomspace(2, 0.1, 8)
    within = rng.normal(size=(n_classes * per_class, 8)) * np.geomspace(0.02, 0.5, 8)
    mixing = rng.normal(size=(8, 8))
    logs = (np.repeat(centres, per_class, axis=0) + within) @ mixing
    return logs, classes_of(len(logs), per_class)


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
    assert few.apply(logs[:3]).var(axis=0).sum() == pytest.approx(
        logs[:3].var(axis=0).sum()
    )
    with pytest.raises(InputError, match=r"must have shape \(N, 8\).*got \(120, 7\)"):
        whitening.apply(logs[:, :7])


def test_pca_makes_directions_equal_and_damps_small_ones() -> None:
    logs, labels = labelled_logs()
    variances = np.linalg.eigvalsh(np.cov(logs.T))
    whitened = np.linalg.eigvalsh(
        np.cov(fit_whitening("pca", logs, shrinkage=0.05).apply(logs).T)
    )
    expected = variances / (variances + 0.05 * variances[-1])
    np.testing.assert_allclose(
        whitened / whitened[-1], expected / expected[-1], rtol=1e-10
    )
    assert (
        fit_whitening("pca", logs, labels).matrix == fit_whitening("pca", logs).matrix
    ).all()


def test_within_class_makes_spread_within_classes_equal() -> None:
    logs, labels = labelled_logs()
    centres = np.array(
        [logs[[one == label for one in labels]].mean(axis=0) for label in labels]
    )
    pooled = (logs - centres).T @ (logs - centres) / (120 - 12)
    matrix = fit_whitening("within-class", logs, labels, shrinkage=0.3).matrix
    product = matrix @ (0.7 * pooled + 0.3 * np.trace(pooled) / 8 * np.eye(8)) @ matrix
    np.testing.assert_allclose(
        product, product[0, 0] * np.eye(8), atol=1e-10 * product[0, 0]
    )
    strangers = 100 + np.random.default_rng(1).normal(size=(3, 8))
    alone = fit_whitening("within-class", logs, labels)
    among = fit_whitening(
        "within-class", np.vstack([strangers, logs]), [None, "single", None, *labels]
    )
    assert among.n_fitted == alone.n_fitted == len(logs)
    np.testing.assert_allclose(among.matrix, alone.matrix, rtol=1e-12)


def test_values_with_different_units_do_not_depend_on_the_units() -> None:
    logs, labels = labelled_logs()
    units = np.geomspace(0.1, 10, 8)

    def gaps(points: FloatArray, *, one_unit: bool) -> FloatArray:
        whitening = fit_whitening("within-class", points, labels, one_unit=one_unit)
        d = pairwise("log", *(whitening.apply(points),) * 2)
        relative: FloatArray = d / d.mean()
        return relative

    np.testing.assert_allclose(
        gaps(logs, one_unit=False), gaps(logs * units, one_unit=False), rtol=1e-6
    )
    apart = gaps(logs, one_unit=True) - gaps(logs * units, one_unit=True)
    assert np.abs(apart).max() > 0.1
    table = table_of(logs, labels)
    kinds: tuple[tuple[str, Metric, bool], ...] = (
        ("hapt", "histograms", True),
        ("hapt+r-bihdm", "values", True),
        ("vectors", "values", False),
    )
    for kind, metric, is_one in kinds:
        assert replace(table, kind=kind, metric=metric).has_one_unit == is_one
    constant = np.column_stack([logs, np.ones(len(logs))])
    assert np.isfinite(
        fit_whitening("within-class", constant, labels, one_unit=False).matrix
    ).all()


def test_what_cannot_be_fitted() -> None:
    logs, labels = labelled_logs()
    with pytest.raises(
        OptionError, match=r"whitening must be one of auto, none, people, .*, got 'zca'"
    ):
        fit_whitening("zca", logs)
    for kind in FITTED:
        for shrinkage in (0.0, -0.1, 1.5, np.nan):
            with pytest.raises(
                OptionError, match=rf"shrinkage must lie in \(0, 1\], got {shrinkage}"
            ):
                fit_whitening(kind, logs, labels, shrinkage=shrinkage)
    too_few = "whitening needs at least 2 distinct shapes.*use the"
    for kind, rows, given, message in (
        ("pca", np.zeros((0, 3)), "", f"pca {too_few}"),
        ("pca", np.ones((1, 3)), "", f"pca {too_few}"),
        ("pca", np.ones((5, 3)), "", f"pca {too_few}"),
        ("pca", np.zeros(3), "", r"must be finite and have shape \(N, L\)"),
        ("pca", np.full((3, 2), np.nan), "", r"must be finite and have shape \(N, L\)"),
        ("within-class", np.ones((4, 3)), "aabb", f"within-class {too_few}"),
        (
            "within-class",
            np.repeat(np.eye(3), 2, axis=0),
            "aabbcc",
            "got equal signatures in every class",
        ),
        (
            "within-class",
            np.eye(4),
            ["a", "b", "c", None],
            "with at least 2 shapes, got 3 classes and none",
        ),
    ):
        with pytest.raises(InputError, match=message):
            fit_whitening(kind, rows, given)
    arrays = fit_whitening("none", np.zeros((2, 3))).to_arrays()
    for changed, message in (
        ({"kind": np.array("zca")}, "whitening must be one of"),
        (
            {"matrix": np.eye(2)},
            r"matrix must have shape \(3, 3\), got \(2, 2\)",
        ),
        ({"mean": np.full(3, np.nan)}, "must be finite"),
    ):
        with pytest.raises((InputError, OptionError), match=message):
            Whitening.from_arrays(arrays | changed)


def test_auto_uses_labels_that_determine_the_covariance() -> None:
    logs, labels = labelled_logs()
    assert (
        fit_whitening("auto", logs, labels).reason
        == "within-class: 12 classes of 120 shapes"
    )
    for unknown in (None, [None] * len(logs), [*labels[:40], *[None] * 80]):
        assert (
            fit_whitening("auto", logs, unknown).kind == "neighbours"
        )  # 0, 0 and 4 classes
    sparse = [label if row % 10 < 2 else None for row, label in enumerate(labels)]
    assert (
        fit_whitening("auto", logs, sparse).kind == "within-class"
    )  # 12 classes of 2, rank 12
    assert (
        fit_whitening("auto", np.hstack([logs, logs]), sparse).kind == "neighbours"
    )  # 16 values
    few = fit_whitening("neighbours", logs[:23])
    assert (
        few.reason == "none, because 23 shapes are too few to learn from neighbours (24)"
    )
    equal = fit_whitening("neighbours", np.ones((30, 3)))
    assert (
        equal.kind == "none"
        and "only 0 pairs of shapes are mutual neighbours" in equal.reason
    )


def test_classes_that_overlap_by_pose_are_separated() -> None:
    """By their labels, and without labels by what neighbours differ by; a prior takes part in the latter."""
    logs, labels = labelled_logs(30)

    def precision(points: FloatArray) -> float:
        return evaluate_table(
            table_of(points, labels), RetrievalOptions(whitening="none")
        ).map

    plain = precision(logs)
    assert plain < 0.9
    for kind in ("within-class", "neighbours"):
        assert precision(fit_whitening(kind, logs, labels).apply(logs)) > plain + 0.05


def test_classes_of_two_poses_teach_what_differs_between_these() -> None:
    """Neighbourhoods overlap as much within a pose, of 5 shapes, as within a class, of 10, which counts."""
    rng = np.random.default_rng(0)
    poses = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    centres = [10 * x + pose for x in np.eye(3) for pose in poses]
    logs = np.repeat(centres, 5, axis=0) + 0.01 * rng.normal(size=(30, 3))
    whitening = fit_whitening("neighbours", logs)
    assert "each among the other's 9 nearest" in whitening.reason
    *others, along_poses = np.diag(whitening.matrix)
    assert along_poses < 0.7 * min(others)


# --- people ---------------------------------------------------------------------------------------------


def some_people(known: People, n_people: int = 60) -> tuple[FloatArray, list[str]]:
    """Three scans of each of some people, drawn from the two normal distributions of the metric."""
    rng = np.random.default_rng(0)
    between = rng.multivariate_normal(
        known.mean, known.total - known.within, n_people, method="eigh"
    )
    within = rng.multivariate_normal(
        0 * known.mean, known.within, 3 * n_people, method="eigh"
    )
    return np.repeat(between, 3, axis=0) + within, [
        f"{row // 3}" for row in range(3 * n_people)
    ]


@pytest.mark.parametrize("size_weight", [0.0, 6.0])
@pytest.mark.parametrize("method", ["hapt+r-bihdm", "r-bihdm", "hapt"])
def test_the_metric_of_people_finds_them(method: str, size_weight: float) -> None:
    if size_weight and method == "hapt":
        return
    options = SignatureOptions(method=method, size_weight=size_weight)
    known = people(options)
    assert known is not None
    assert len(known.mean) == signature_length(options)
    assert (
        np.linalg.eigvalsh(known.metric)[0] > -1e-6 * np.linalg.eigvalsh(known.metric)[-1]
    )
    logs, labels = some_people(known)
    assert known.unlikeness(logs) == pytest.approx(1, rel=0.3)
    whitening = fit_whitening("auto", logs, labels, people=known)
    assert whitening.kind == "people"
    table = replace(table_of(logs, labels), values=logs, metric="values", digest="")
    plain = fit_whitening("none", logs)
    found, without = (
        evaluate_table(table, whitening=one).map for one in (whitening, plain)
    )
    # Damaged scans, of which the metric knows too, are hardly told apart by R-BiHDM alone.
    assert 1 - found < (0.9 if method == "r-bihdm" else 0.65) * (1 - without)
    # Scans of others are compared by their own neighbours, the more so the less they are like people.
    far = known.mean + 30 * (logs - known.mean)
    assert fit_whitening("auto", far, people=known).kind == "neighbours"
    assert (
        "% from neighbours: "
        in fit_whitening("people", 2 * logs - known.mean, people=known).reason
    )
    # Three scans are compared by the simulated people alone.
    assert fit_whitening("unsupervised", logs[:3], people=known).n_fitted == 0
    # Labelled scans adapt it; of others, the classes alone are used.
    learned = calibrated_whitening(table, RetrievalOptions(), known)
    assert learned.kind == "people" and " from within-class: " in learned.reason
    alone = calibrated_whitening(replace(table, values=far), RetrievalOptions(), known)
    assert alone.kind == "within-class"


def test_missing_limbs_count_less_though_a_catalogue_shows_none() -> None:
    known = people(SignatureOptions())
    assert known is not None
    lost = known.limbs[:, -1]  # in the direction of the largest change
    unaware = known._replace(limbs=0 * known.limbs)
    counted, before = (
        lost @ one.adapted(known.within, 0.5).metric @ lost for one in (known, unaware)
    )
    assert 0 < counted < 0.8 * before


def test_scans_of_unusual_people_may_differ_more() -> None:
    known = people(SignatureOptions())
    assert known is not None
    logs, labels = some_people(known, 200)
    whitening = fit_whitening("people", known.mean[np.newaxis], people=known)
    plain = replace(whitening, unusual=np.zeros((0, 0)))
    # The mean square of the expected part of the person, S_b S_t⁻¹ (x − μ), in units of S_b.
    parts = np.linalg.solve(known.total, (logs - known.mean).T)
    between = known.total - known.within
    squares = (parts * (between @ parts)).sum(axis=0)
    unusual = squares / np.trace(np.linalg.solve(known.total, between))
    assert unusual.mean() == pytest.approx(1, rel=0.1)
    lengths = (np.minimum(unusual, MOST_UNUSUAL) + USUAL) / (1 + USUAL)
    np.testing.assert_allclose(
        whitening.apply(logs), plain.apply(logs) / np.sqrt(lengths)[:, None], rtol=1e-4
    )
    # Where unusual people do differ more from themselves, fewer of them are refused.
    person = np.repeat(logs[::3], 3, axis=0)
    drawn = person + 1.5 * np.sqrt(lengths)[::3].repeat(3)[:, None] * (logs - person)
    errors, first = [], np.arange(len(drawn))
    same = np.equal.outer(labels, labels)[first[:, None] < first]
    for one in (plain, whitening):
        points = one.apply(drawn)
        apart = pairwise("log", points, points)[first[:, None] < first]
        found = verification(np.sort(apart[same]), np.sort(apart[~same]))
        assert found is not None
        errors.append(found.missed(1e-3))
    assert errors[1] < 0.8 * errors[0], errors
    # Beyond all people, every scan is as unusual.
    far = known.mean + 30 * (logs - known.mean)
    ratio = np.linalg.norm(plain.apply(far), axis=1) / np.linalg.norm(
        whitening.apply(far), axis=1
    )
    np.testing.assert_allclose(ratio, ratio[0])


def test_the_metric_of_people_is_known_for_these_signatures_alone() -> None:
    for name, value in (
        ("method", "csd"),
        ("n_modes", 59),
        ("n_values", 60),
        ("scale", "relative"),
    ):
        assert people(SignatureOptions.model_validate({name: value})) is None
    fused, alone = (
        people(SignatureOptions(method=method)) for method in ("r-bihdm+hapt", "r-bihdm")
    )
    assert fused is not None and alone is not None
    spread = DESCRIPTORS["r-bihdm"].spread
    np.testing.assert_allclose(
        fused.within[:23, :23] * spread**2, alone.within, rtol=1e-5
    )
    default = people(SignatureOptions(size_weight=6.0))
    assert default is not None
    logs = some_people(default)[0]
    whitening = fit_whitening("people", logs, people=default)
    assert (
        Whitening.from_arrays(whitening.to_arrays()).apply(logs[5:6])
        == whitening.apply(logs)[5]
    ).all()
    with pytest.raises(
        OptionError,
        match="whitening 'people' is known for hapt, r-bihdm and their fusion",
    ):
        fit_whitening("people", np.ones((3, 8)))


@pytest.mark.parametrize("method", ("hapt+r-bihdm", "r-bihdm+hapt"))
def test_limbs_that_are_not_parted_do_not_pair_strangers(method: str) -> None:
    """What R-BiHDM is depends on how limbs are joined, and not on the class."""
    known, rng = people(SignatureOptions(method=method)), np.random.default_rng(1)
    assert known is not None
    label = np.repeat(np.arange(12), 6)
    parts = {
        "hapt": rng.normal(0, 0.25, (12, 154))[label] + rng.normal(0, 0.05, (72, 154)),
        "r-bihdm": rng.normal(0, 2, (72, 23)),
    }
    logs = np.hstack([parts[name] for name in method.split("+")])
    right = []
    for moments in (known, None):
        points = fit_whitening("neighbours", logs, people=moments).apply(logs)
        apart = pairwise("log", points, points)
        np.fill_diagonal(apart, np.inf)
        right.append((label[apart.argmin(axis=1)] == label).mean())
    assert right[0] == 1 and right[1] < 0.5


def test_labels_are_used_by_auto_alone() -> None:
    logs, labels = posed_logs(), classes_of(60, 6)
    assert fit_whitening("auto", logs, labels).kind == "within-class"
    without = fit_whitening("unsupervised", logs)
    assert fit_whitening("unsupervised", logs, labels) == without
    assert without.kind != "within-class"


def test_a_form_is_compared_with_those_of_people_whole_and_without_a_limb() -> None:
    sample = installed()
    means = {"whole": sample["mean"][154:177], "limbless": sample["limbless_mean"]}
    covariances = {
        "whole": sample["total"][154:177, 154:177],
        "limbless": sample["limbless"],
    }
    place = 0.6 * means["limbless"] + 0.4 * means["whole"]
    scale = sample["scale"][154:177]
    densities = {
        name: multivariate_normal(means[name], covariances[name]).logpdf(place)
        for name in means
    }
    assert limbless_ratio(np.exp(scale * place)) == pytest.approx(
        densities["limbless"] - densities["whole"]
    )
    # Bones are 25 times as unlike people.
    assert limbless_ratio(np.exp(scale * (place + 5))) is None
