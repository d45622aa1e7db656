"""Descriptors that are fused by their names."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import shapes
from pydantic import ValidationError

from pcretrieve.descriptors import DESCRIPTORS, Descriptor, describe, signature_length
from pcretrieve.errors import OptionError
from pcretrieve.options import PipelineOptions, SignatureOptions
from pcretrieve.pipeline.process import process
from pcretrieve.retrieval import coordinates
from pcretrieve.values import Shape, Signature


@cache
def body() -> Shape:
    return process(shapes.body(3), PipelineOptions())


def options(method: str, **changed: object) -> SignatureOptions:
    return SignatureOptions.model_validate({"method": method, "n_values": 9, **changed})


def test_values_are_the_coordinates_of_the_parts_in_units_of_their_spread() -> None:
    found = describe(body(), options("hapt+r-bihdm+ispm"))
    assert (found.kind, found.metric) == ("hapt+r-bihdm+ispm", "values")
    parts = []
    for name in ("hapt", "r-bihdm", "ispm"):
        alone = describe(body(), options(name))
        parts.append(coordinates(alone.values, alone.metric) / DESCRIPTORS[name].spread)
        assert alone.digest in found.digest
    np.testing.assert_array_equal(found.values, np.concatenate(parts))
    assert signature_length(options("hapt+r-bihdm+ispm")) == len(found.values)


def test_squared_distances_add_up() -> None:
    other = process(shapes.ellipsoid((1, 1, 1.4), subdivisions=3), PipelineOptions())

    def squared(method: str) -> float:
        one, two = (describe(shape, options(method)) for shape in (body(), other))
        between = coordinates(one.values, one.metric) - coordinates(two.values, two.metric)
        return float(between @ between)

    spreads = {name: DESCRIPTORS[name].spread for name in ("csd", "shape-dna")}
    expected = sum(squared(name) / spread**2 for name, spread in spreads.items())
    assert squared("csd+shape-dna") == pytest.approx(expected)


def test_a_fusion_needs_what_its_parts_need() -> None:
    assert set(DESCRIPTORS["hapt+r-bihdm"].needs) == {"mesh", "spectrum"}
    assert DESCRIPTORS["csd+ispm"].needs == ("eigenvectors",)


def test_the_scale_absolute_needs_one_part_with_a_size() -> None:
    large = describe(body(), options("hapt+shape-dna", scale="absolute"))
    form = describe(body(), options("hapt+shape-dna", scale="area"))
    np.testing.assert_array_equal(large.values[:45], form.values[:45])
    sizes = (large.values - form.values)[45:] * DESCRIPTORS["shape-dna"].spread
    np.testing.assert_allclose(sizes, np.log(body().area))
    with pytest.raises(
        OptionError, match=r"scale: must be area or relative for hapt\+csd, which has no size"
    ):
        SignatureOptions(method="hapt+csd", scale="absolute")


def test_a_size_is_one_value_more() -> None:
    sized = describe(body(), options("hapt+csd", size_weight=2.0))
    assert sized.values[-1] == pytest.approx(2 * np.log(body().area))


@pytest.mark.parametrize(("method", "got"), [("hapt+weight", "'weight'"), ("+hapt", "''"), ("hapt+", "''")])
def test_names_that_are_none(method: str, got: str) -> None:
    with pytest.raises((OptionError, ValidationError), match=f"should be one of r-bihdm, .*, got {got}"):
        SignatureOptions(method=method)


def test_a_spread_must_be_positive() -> None:
    with pytest.raises(OptionError, match="spread of a descriptor must be positive, got 0"):
        Descriptor("x", lambda shape, options: Signature(np.ones(1), kind="x"), needs=(), spread=0.0)
