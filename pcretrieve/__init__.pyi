# What `import pcretrieve` offers. Type checkers read this file, and `__init__.py` imports each name from the
# module named here when it is first used.

from .catalogue import Catalogue, Record, backup, export_vectors, merge_catalogues
from .checks import Inspection
from .descriptors import Descriptor, describe, r_bihdm, shape_dna
from .errors import (
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
from .estimators import (
    NeighbourWhitening,
    PCAWhitening,
    ResolutionWhitening,
    SignatureNeighbors,
    SignatureTransformer,
    WithinClassWhitening,
)
from .evaluation import Comparison, Evaluation, RetrievalMeasures, calibrate, compare, evaluate, matrix
from .formats import read_scan, write_cloud, write_mesh, write_signatures
from .ingestion import (
    BatchStatus,
    Check,
    DaskExecutor,
    Summary,
    check,
    ingest,
    report_problem,
    retry,
    status,
    watch,
)
from .ingestion.views import merge_views
from .matching import DistanceMatrix, read_matrix, write_matrix
from .options import MergeOptions, PipelineOptions
from .pages import draw_map, query_page, report
from .pages.inspecting import inspect
from .pipeline.inspecting import signature_spread
from .pipeline.process import process, reconstruct, signature
from .query import Answer, cluster, duplicates, search, search_many
from .retrieval import SignatureIndex, Whitening
from .spectral import eigenpairs, laplace_beltrami
from .values import (
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
from .web import serve

__version__: str

__all__ = [
    "Answer",
    "BatchStatus",
    "BenchmarkError",
    "Catalogue",
    "CatalogueError",
    "Check",
    "Comparison",
    "DaskExecutor",
    "DegenerateMeshError",
    "Descriptor",
    "DistanceMatrix",
    "Eigenpairs",
    "Evaluation",
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
    "Record",
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
    "Summary",
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
    "export_vectors",
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
