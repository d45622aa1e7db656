"""Descriptors that are fused by their names."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import shapes

from pcretrieve.descriptors import DESCRIPTORS, describe, signature_length
from pcretrieve.options import PipelineOptions, SignatureOptions
from pcretrieve.pipeline.process import process
from pcretrieve.retrieval import coordinates
from pcretrieve.values import Shape


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
