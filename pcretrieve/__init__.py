"""pcretrieve: raw 3D scans of things that bend in, ranked shapes out.

Names are imported when first used, so that ``import pcretrieve`` takes no time.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pcretrieve.catalogue import Catalogue
    from pcretrieve.descriptors import r_bihdm, shape_dna
    from pcretrieve.formats import read_scan
    from pcretrieve.inspection.inspect import signature_spread
    from pcretrieve.options import PipelineOptions
    from pcretrieve.pipeline.process import reconstruct, signature
    from pcretrieve.retrieval import SignatureIndex
    from pcretrieve.spectral import eigenpairs, laplace_beltrami
    from pcretrieve.types import PointCloud, TriangleMesh

__version__ = "0.1.0"

__all__ = [
    "Catalogue",
    "PipelineOptions",
    "PointCloud",
    "SignatureIndex",
    "TriangleMesh",
    "__version__",
    "eigenpairs",
    "laplace_beltrami",
    "r_bihdm",
    "read_scan",
    "reconstruct",
    "shape_dna",
    "signature",
    "signature_spread",
]

_HOMES = {
    "Catalogue": "pcretrieve.catalogue",
    "PipelineOptions": "pcretrieve.options",
    "PointCloud": "pcretrieve.types",
    "SignatureIndex": "pcretrieve.retrieval",
    "TriangleMesh": "pcretrieve.types",
    "eigenpairs": "pcretrieve.spectral",
    "laplace_beltrami": "pcretrieve.spectral",
    "r_bihdm": "pcretrieve.descriptors",
    "read_scan": "pcretrieve.formats",
    "reconstruct": "pcretrieve.pipeline.process",
    "shape_dna": "pcretrieve.descriptors",
    "signature": "pcretrieve.pipeline.process",
    "signature_spread": "pcretrieve.inspection.inspect",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'pcretrieve' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
