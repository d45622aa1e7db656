"""Whitening by resolution: its sample, its effect, and the signatures for which it is not defined."""

from pathlib import Path

import numpy as np
import pytest
from benchmarks.shipped import N_BODIES, log_eigenvalues
from shapes import body, points_on

import pcretrieve.retrieval
from pcretrieve import PipelineOptions
from pcretrieve.descriptors import describe, reduced_matrix
from pcretrieve.errors import OptionError
from pcretrieve.options import SignatureOptions
from pcretrieve.pipeline.process import process
from pcretrieve.retrieval import resolution_whitening
from pcretrieve.retrieval.resolution import N_MODES
from pcretrieve.values import FloatArray

SAMPLE = np.load(Path(pcretrieve.retrieval.__file__).with_name("resolution.npy"))


def test_the_sample_is_what_its_module_measures() -> None:
    made = log_eigenvalues("animal", 3)
    stored = SAMPLE[:, N_BODIES + 3]
    # Rounding on another machine may move a voxel from one side of the surface to the other.
    np.testing.assert_allclose(made, stored, rtol=0, atol=0.02)
    assert np.abs(made[0] - made[1]).max() > 0.02


@pytest.mark.parametrize("scale", ["area", "relative"])
@pytest.mark.parametrize("n_values", [1, 23, 60])
def test_what_resolution_changes_counts_less(scale: str, n_values: int) -> None:
    options = SignatureOptions.model_validate({"method": "r-bihdm", "scale": scale, "n_values": n_values})
    whitening = resolution_whitening(options)
    logs = SAMPLE[:, :, :60] - (SAMPLE[:, :, 60:] if scale == "relative" else 0)
    change = (logs[0] - logs[1])[:, :n_values].astype(np.float64)
    size = np.linalg.norm(change, axis=1)
    change = change[np.argsort(size)][: whitening.n_fitted]
    anything = np.random.default_rng(0).normal(size=(4000, n_values))

    def stretch(differences: FloatArray) -> float:
        mapped = differences @ whitening.matrix
        return float((mapped**2).sum() / (differences**2).sum())

    assert stretch(anything) == pytest.approx(1, rel=0.1)
    assert stretch(change) < 0.5 or n_values == 1
    assert whitening.kind == "resolution"
    assert 0.8 * len(size) < whitening.n_fitted < 0.9 * len(size)


def test_values_by_area_are_what_the_sample_holds() -> None:
    """Order and unit of a signature are those of the sample's columns."""
    shape = process(points_on(body(), 6000), PipelineOptions().changed(surface={"reconstructions": 1}))
    logs = np.log(np.abs(np.linalg.eigvalsh(reduced_matrix(shape.spectrum, N_MODES))))
    values = describe(shape, SignatureOptions(method="r-bihdm", n_values=60)).values
    np.testing.assert_allclose(np.log(values), logs[:60], rtol=1e-12)
    relative = describe(shape, SignatureOptions(method="r-bihdm", n_values=60, scale="relative")).values
    np.testing.assert_allclose(np.log(relative), logs[:60] - logs[60], rtol=1e-9, atol=1e-12)


def test_size_stays_what_it_is() -> None:
    logs = np.random.default_rng(0).normal(size=(5, SignatureOptions().n_values + 1))
    form = resolution_whitening(SignatureOptions(method="r-bihdm")).apply(logs[:, :-1])
    sized = resolution_whitening(SignatureOptions(method="r-bihdm", size_weight=6)).apply(logs)
    np.testing.assert_allclose(sized, np.column_stack([form, logs[:, -1]]), rtol=1e-12)


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"method": "shape-dna"},
        {"method": "r-bihdm", "n_modes": 50},
        {"method": "r-bihdm", "scale": "absolute"},
    ],
)
def test_signatures_that_were_not_measured(given: dict[str, str | int]) -> None:
    options = SignatureOptions.model_validate(given)
    with pytest.raises(OptionError, match="'resolution' has been measured for r-bihdm with n_modes = 60"):
        resolution_whitening(options)


def test_shrinkage_must_be_a_share() -> None:
    with pytest.raises(OptionError, match=r"shrinkage must lie in \(0, 1\], got 0"):
        resolution_whitening(SignatureOptions(method="r-bihdm"), shrinkage=0)
