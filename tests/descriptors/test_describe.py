"""Properties of all descriptors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import shapes

from pcretrieve.descriptors import (
    DESCRIPTORS,
    bihdm,
    csd,
    describe,
    r_bihdm,
    shape_dna,
    signature_length,
    wks,
)
from pcretrieve.errors import OptionError
from pcretrieve.options import PipelineOptions, SignatureOptions
from pcretrieve.pipeline.process import process
from pcretrieve.plugins import METHODS
from pcretrieve.retrieval import coordinates
from pcretrieve.shrec.spectra import geodesic_matrix
from pcretrieve.spectral import unit_eigenpairs
from pcretrieve.values import FloatArray, Shape, Signature, TriangleMesh

N_VALUES = 9

# With other vertex numbers the simplified mesh of the geodesic distances differs: ties are broken by number.
TOLERANCE = dict.fromkeys(METHODS, 1e-6) | {
    "sd-gdm": 0.05,
    "sd-gdm-sampled": 0.05,
    "hapt": 1e-3,
}


@pytest.fixture(params=METHODS)
def method(request: pytest.FixtureRequest) -> str:
    name: str = request.param
    if name.startswith("sd-gdm"):
        pytest.importorskip(
            "potpourri3d", reason="geodesic distances come from potpourri3d"
        )
    return name


@cache
def body() -> Shape:
    return process(shapes.body(3), PipelineOptions())


@cache
def longer() -> Shape:
    return process(shapes.ellipsoid((1, 1, 1.4), subdivisions=3), PipelineOptions())


def options(method: str, **more: Any) -> SignatureOptions:
    return SignatureOptions(method=method, n_values=N_VALUES, **more)


def values(shape: Shape, method: str, scale: str = "relative") -> FloatArray:
    return describe(shape, options(method, scale=scale)).values


def compared(shape: Shape, method: str) -> FloatArray:
    """What distances compare: the logarithms of the values, or the roots of the bins of a histogram."""
    return coordinates(values(shape, method), DESCRIPTORS[method].metric)


# Numbers of values of the descriptors that do not have as many as `n_values` says.
LENGTHS = {
    "ispm": (1 + 2 + 4 + 8) * N_VALUES,
    "hapt": 22 * 7,
    "moments": 6,
    **dict.fromkeys(
        ("hks-bow-spatial", "si-hks-bow-spatial"), N_VALUES * (N_VALUES + 1) // 2
    ),
    **dict.fromkeys(("dl", "dl-supervised"), 32),
}


def test_a_descriptor_says_what_it_is_and_is_positive(method: str) -> None:
    signature = describe(body(), options(method))
    assert signature.kind == method
    assert len(signature.values) == LENGTHS.get(method, N_VALUES)
    assert np.isfinite(compared(body(), method)).all()
    for size_weight in (0.0,) if signature.metric == "histograms" else (0.0, 1.0):
        chosen = options(method, size_weight=size_weight)
        assert signature_length(chosen) == len(describe(body(), chosen).values)


@pytest.mark.parametrize("change", [shapes.moved, shapes.renumbered])
def test_it_does_not_see_motion_or_numbering(method: str, change) -> None:  # type: ignore[no-untyped-def]
    other = process(change(shapes.body(3), 1), PipelineOptions())
    np.testing.assert_allclose(
        compared(other, method), compared(body(), method), atol=TOLERANCE[method]
    )


# Powers of length of the values for the scale absolute.
POWERS = {
    "r-bihdm": 4,
    "bihdm": 4,
    "bihdm-sampled": 4,
    "shape-dna": 2,
    "sd-gdm": 3,
    "sd-gdm-sampled": 3,
}


def test_size_is_kept_where_it_is_asked_for_and_nowhere_else(method: str) -> None:
    twice = process(
        TriangleMesh(2 * shapes.body(3).vertices, shapes.body(3).faces), PipelineOptions()
    )
    np.testing.assert_allclose(values(twice, method), values(body(), method), rtol=1e-5)
    by_area = values(twice, method, "area")
    np.testing.assert_allclose(by_area, values(body(), method, "area"), rtol=1e-5)
    if not METHODS[method]:
        return
    power, absolute = np.array(POWERS[method]), values(twice, method, "absolute")
    np.testing.assert_allclose(by_area * twice.area ** (power / 2), absolute, rtol=1e-5)
    np.testing.assert_allclose(
        absolute / values(body(), method, "absolute"), 2.0**power, rtol=1e-5
    )


@pytest.mark.parametrize("function", [r_bihdm, bihdm])
def test_a_descriptor_by_itself_is_that_of_the_default_options(
    function: Callable[..., Signature],
) -> None:
    described = describe(
        body(), SignatureOptions(method=function.__name__.replace("_", "-"))
    )
    by_itself, relative = (
        function(body().spectrum),
        function(body().spectrum, scale="relative"),
    )
    assert (described, described.digest) == (by_itself, by_itself.digest)
    assert not np.allclose(described.values, relative.values, rtol=0.1)


def test_the_compact_shape_descriptor_of_a_sphere_is_that_of_each_of_its_points() -> None:
    """By the addition theorem Σ φ² over the modes of one eigenvalue is constant on a sphere."""
    degrees = np.arange(7)  # of λ = 4π l (l + 1) on unit area, 2 l + 1 times
    pairs = unit_eigenpairs(shapes.icosphere(4), (2 * degrees + 1).sum())
    found = csd(pairs, 9, n_modes=48).values
    np.testing.assert_allclose(found[:6], 6**-0.5, rtol=0.02)
    times = np.geomspace(0.001, 1, 97)
    kernel = np.exp(-4 * np.pi * np.outer(times, degrees * (degrees + 1))) @ (
        2 * degrees + 1
    )
    frequencies = np.abs(np.fft.rfft(np.diff(np.log(kernel))))[:3]
    np.testing.assert_allclose(
        found[6:], frequencies / np.linalg.norm(frequencies), atol=0.002
    )
    assert (
        len(csd(body().eigenpairs, 147).values) == 147
    )  # as the heat kernel has frequencies
    for n_values in (2, 148):
        with pytest.raises(
            OptionError,
            match=f"n_values must be between 3 and 147 for csd, got {n_values}",
        ):
            csd(body().eigenpairs, n_values)


def test_shape_dna_by_its_first_value_is_a_ratio_that_needs_no_area() -> None:
    spectrum = body().spectrum
    ratios = shape_dna(spectrum, 8, normalized_by="first").values
    np.testing.assert_allclose(
        1 / ratios, spectrum.eigenvalues[2:10] / spectrum.eigenvalues[1]
    )


def test_waves_are_spread_evenly_over_a_sphere_only() -> None:
    """Whole multiplets: Σ φ² over an eigenspace is constant on a sphere, as the addition theorem has it."""
    ball = process(shapes.icosphere(4), PipelineOptions()).spectrum
    assert np.abs(wks(ball, 5, 48).values[0] - 1) < 5e-3  # l = 1 … 6
    assert (wks(body().spectrum, 5, 48).values > 1.05).all()


def test_pairs_of_words_depend_on_the_positions_of_words() -> None:
    """The heat kernel has unit row sums: the pairs of a word sum up to the frequency of the word."""
    pairs = values(body(), "hks-bow-spatial") - 1e-3
    table = np.zeros((N_VALUES, N_VALUES))
    table[np.triu_indices(N_VALUES)] = pairs
    table = np.maximum(table, table.T)
    shares = values(body(), "hks-bow") - 1e-3
    np.testing.assert_allclose(table.sum(axis=1), shares, atol=2e-3)


def test_geodesic_distances_of_a_sphere() -> None:
    """The operator of great-circle distances: its constant mode is ∫ d = 4π · π/2, and it is compact."""
    pytest.importorskip("potpourri3d", reason="geodesic distances come from potpourri3d")
    matrix = geodesic_matrix(shapes.icosphere(3))  # 1280 faces: simplified
    assert len(matrix) == 502
    np.testing.assert_array_equal(matrix, matrix.T)
    largest = np.linalg.eigvalsh(matrix)[-1]
    assert largest == pytest.approx(2 * np.pi**2, rel=0.03)


def both() -> Shape:
    """A scan that was made into two surfaces."""
    return Shape((*body().surfaces, *longer().surfaces))


def test_a_shape_of_several_surfaces_is_described_by_their_mean(method: str) -> None:
    """Each descriptor is given the surface that it describes, be it as a spectrum or as a mesh."""
    mean = describe(both(), options(method))
    assert mean.errors is not None
    assert mean.errors.max() > 0
    assert describe(body(), options(method)).errors is None
    log = np.log if mean.metric == "logarithms" else np.asarray
    parts = (replace(body(), number=0), replace(longer(), number=1))
    rows = np.array([log(describe(shape, options(method)).values) for shape in parts])
    np.testing.assert_allclose(log(mean.values), rows.mean(axis=0), rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        mean.errors, np.abs(rows[0] - rows[1]) / np.sqrt(2), atol=1e-12
    )


def test_size_is_one_value_more_beside_the_form(method: str) -> None:
    shape = Shape(
        (replace(body().surfaces[0], area=3.0), replace(longer().surfaces[0], area=3.3))
    )
    weighted = options(method).model_copy(update={"size_weight": 6.0})
    if DESCRIPTORS[method].metric == "histograms":
        with pytest.raises(
            OptionError,
            match=f"size_weight must be 0 for {method}, whose values are a hist",
        ):
            describe(shape, weighted)
        return
    form, sized = describe(shape, options(method)), describe(shape, weighted)
    np.testing.assert_array_equal(sized.values[:-1], form.values)
    areas = 6 * np.log([3.0, 3.3])
    size = sized.values[-1] if form.metric == "values" else np.log(sized.values[-1])
    assert size == pytest.approx(areas.mean())
    assert sized.errors is not None
    assert sized.errors[-1] == pytest.approx(areas.std(ddof=1))


def test_fused_values_are_the_coordinates_of_the_parts_in_units_of_their_spread() -> None:
    found = describe(body(), options("hapt+r-bihdm+ispm"))
    assert (found.kind, found.metric) == ("hapt+r-bihdm+ispm", "values")
    parts = []
    for name in ("hapt", "r-bihdm", "ispm"):
        alone = describe(body(), options(name))
        parts.append(coordinates(alone.values, alone.metric) / DESCRIPTORS[name].spread)
        assert alone.digest in found.digest
    np.testing.assert_array_equal(found.values, np.concatenate(parts))
    assert signature_length(options("hapt+r-bihdm+ispm")) == len(found.values)
