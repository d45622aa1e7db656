"""pcretrieve: raw 3D scans of things that bend in, ranked shapes out.

Names are imported when first used, so that ``import pcretrieve`` takes no time.
"""

from __future__ import annotations

import logging
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pcretrieve.catalogue import Catalogue, backup, merge_catalogues
    from pcretrieve.checks import Inspection
    from pcretrieve.descriptors import Descriptor, describe, r_bihdm, shape_dna
    from pcretrieve.errors import (
        BenchmarkError,
        CatalogueError,
        DegenerateMeshError,
        InputError,
        MemoryExceeded,
        OptionError,
        PcretrieveError,
        ReconstructionError,
        RemeshError,
        ScanReadError,
        ShapeError,
        SpectrumError,
        StageTimeout,
        UnexpectedError,
        WorkerDied,
    )
    from pcretrieve.estimators import (
        NeighbourWhitening,
        PCAWhitening,
        ResolutionWhitening,
        SignatureNeighbors,
        SignatureTransformer,
        WithinClassWhitening,
    )
    from pcretrieve.evaluation import RetrievalMeasures, calibrate, compare, evaluate, matrix
    from pcretrieve.formats import read_scan, write_cloud, write_mesh, write_signatures
    from pcretrieve.ingestion import DaskExecutor
    from pcretrieve.ingestion.arrivals import watch
    from pcretrieve.ingestion.problems import report_problem
    from pcretrieve.ingestion.progress import status
    from pcretrieve.ingestion.recomputing import check
    from pcretrieve.ingestion.run import ingest, retry
    from pcretrieve.ingestion.views import merge_views
    from pcretrieve.matching import DistanceMatrix, read_matrix, write_matrix
    from pcretrieve.options import MergeOptions, PipelineOptions
    from pcretrieve.pages import draw_map, query_page, report
    from pcretrieve.pages.inspecting import inspect
    from pcretrieve.pipeline.inspecting import signature_spread
    from pcretrieve.pipeline.process import process, reconstruct, signature
    from pcretrieve.query import Answer, cluster, duplicates, search, search_many
    from pcretrieve.retrieval import SignatureIndex, Whitening
    from pcretrieve.spectral import eigenpairs, laplace_beltrami
    from pcretrieve.values import (
        Eigenpairs,
        LaplaceBeltrami,
        ModalSpectrum,
        Neighbors,
        PointCloud,
        Shape,
        Signature,
        SignatureTable,
        Step,
        Surface,
        TriangleMesh,
        Verdict,
    )
    from pcretrieve.web import serve

__version__ = "0.2.0"

# Without it, warnings of a library go to standard error where the program has not set up logging.
logging.getLogger("pcretrieve").addHandler(logging.NullHandler())

__all__ = [
    "Answer",
    "BenchmarkError",
    "Catalogue",
    "CatalogueError",
    "DaskExecutor",
    "DegenerateMeshError",
    "Descriptor",
    "DistanceMatrix",
    "Eigenpairs",
    "InputError",
    "Inspection",
    "LaplaceBeltrami",
    "MemoryExceeded",
    "MergeOptions",
    "ModalSpectrum",
    "Neighbors",
    "NeighbourWhitening",
    "OptionError",
    "PCAWhitening",
    "PcretrieveError",
    "PipelineOptions",
    "PointCloud",
    "ReconstructionError",
    "RemeshError",
    "ResolutionWhitening",
    "RetrievalMeasures",
    "ScanReadError",
    "Shape",
    "ShapeError",
    "Signature",
    "SignatureIndex",
    "SignatureNeighbors",
    "SignatureTable",
    "SignatureTransformer",
    "SpectrumError",
    "StageTimeout",
    "Step",
    "Surface",
    "TriangleMesh",
    "UnexpectedError",
    "Verdict",
    "Whitening",
    "WithinClassWhitening",
    "WorkerDied",
    "__version__",
    "backup",
    "calibrate",
    "check",
    "cluster",
    "compare",
    "describe",
    "draw_map",
    "duplicates",
    "eigenpairs",
    "evaluate",
    "ingest",
    "inspect",
    "laplace_beltrami",
    "matrix",
    "merge_catalogues",
    "merge_views",
    "process",
    "query_page",
    "r_bihdm",
    "read_matrix",
    "read_scan",
    "reconstruct",
    "report",
    "report_problem",
    "retry",
    "search",
    "search_many",
    "serve",
    "shape_dna",
    "signature",
    "signature_spread",
    "status",
    "watch",
    "write_cloud",
    "write_matrix",
    "write_mesh",
    "write_signatures",
]

# The module that defines each name.
_HOMES = {
    "pcretrieve.catalogue": (
        "Catalogue",
        "backup",
        "merge_catalogues",
    ),
    "pcretrieve.descriptors": (
        "Descriptor",
        "describe",
        "r_bihdm",
        "shape_dna",
    ),
    "pcretrieve.errors": (
        "BenchmarkError",
        "CatalogueError",
        "DegenerateMeshError",
        "InputError",
        "MemoryExceeded",
        "OptionError",
        "PcretrieveError",
        "ReconstructionError",
        "RemeshError",
        "ScanReadError",
        "ShapeError",
        "SpectrumError",
        "StageTimeout",
        "UnexpectedError",
        "WorkerDied",
    ),
    "pcretrieve.estimators": (
        "NeighbourWhitening",
        "PCAWhitening",
        "ResolutionWhitening",
        "SignatureNeighbors",
        "SignatureTransformer",
        "WithinClassWhitening",
    ),
    "pcretrieve.evaluation": ("RetrievalMeasures", "calibrate", "compare", "evaluate", "matrix"),
    "pcretrieve.formats": (
        "read_scan",
        "write_cloud",
        "write_mesh",
        "write_signatures",
    ),
    "pcretrieve.checks": ("Inspection",),
    "pcretrieve.ingestion": ("DaskExecutor",),
    "pcretrieve.ingestion.arrivals": ("watch",),
    "pcretrieve.ingestion.problems": ("report_problem",),
    "pcretrieve.ingestion.progress": ("status",),
    "pcretrieve.ingestion.run": ("ingest", "retry"),
    "pcretrieve.ingestion.views": ("merge_views",),
    "pcretrieve.pages.inspecting": ("inspect",),
    "pcretrieve.pipeline.inspecting": ("signature_spread",),
    "pcretrieve.ingestion.recomputing": ("check",),
    "pcretrieve.matching": (
        "DistanceMatrix",
        "read_matrix",
        "write_matrix",
    ),
    "pcretrieve.options": (
        "MergeOptions",
        "PipelineOptions",
    ),
    "pcretrieve.pages": (
        "draw_map",
        "query_page",
        "report",
    ),
    "pcretrieve.pipeline.process": (
        "process",
        "reconstruct",
        "signature",
    ),
    "pcretrieve.query": (
        "Answer",
        "cluster",
        "duplicates",
        "search",
        "search_many",
    ),
    "pcretrieve.retrieval": (
        "SignatureIndex",
        "Whitening",
    ),
    "pcretrieve.spectral": (
        "eigenpairs",
        "laplace_beltrami",
    ),
    "pcretrieve.values": (
        "Eigenpairs",
        "LaplaceBeltrami",
        "ModalSpectrum",
        "Neighbors",
        "PointCloud",
        "Shape",
        "Signature",
        "SignatureTable",
        "Step",
        "Surface",
        "TriangleMesh",
        "Verdict",
    ),
    "pcretrieve.web": ("serve",),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module 'pcretrieve' has no attribute {name!r}")
    return getattr(import_module(_HOME_OF[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
