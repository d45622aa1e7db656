"""Fusion of descriptors: the vectors of several methods one after the other, each scaled by its spread."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

import numpy as np

from pcretrieve.descriptors.descriptor import Descriptor
from pcretrieve.options import SignatureOptions
from pcretrieve.values import FloatArray, Metric, Shape, Signature

__all__ = ["fused"]

#: What distances compare, of values with each metric, as in `pcretrieve.retrieval.distances`.
COORDINATES: Mapping[Metric, Callable[[FloatArray], FloatArray]] = MappingProxyType(
    {"logarithms": np.log, "values": np.asarray, "histograms": np.sqrt}
)


def fused(parts: Sequence[Descriptor]) -> Descriptor:
    """The descriptor whose values are those of several descriptors."""
    name = "+".join(part.name for part in parts)

    def make(shape: Shape, options: SignatureOptions) -> Signature:
        made = [part.make(shape, options) for part in parts]
        scaled = [
            COORDINATES[signature.metric](signature.values) / part.spread
            for part, signature in zip(parts, made, strict=True)
        ]
        digest = ", ".join(f"{signature.kind} {signature.digest}" for signature in made)
        return Signature(np.concatenate(scaled), kind=name, digest=digest, metric="values")

    return Descriptor(
        name=name,
        make=make,
        needs=tuple(dict.fromkeys(need for part in parts for need in part.needs)),
        has_size=any(part.has_size for part in parts),
        length=lambda options: sum(part.length(options) for part in parts),
        metric="values",
    )
