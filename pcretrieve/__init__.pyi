# What `import pcretrieve` offers. Type checkers read this file, and `__init__.py` imports each name from the
# module named here when it is first used.

from .catalogue import (
    Catalogue as Catalogue,
    Record as Record,
    backup as backup,
    mark as mark,
    merge_catalogues as merge_catalogues,
)
from .checks import Inspection as Inspection
from .descriptors import (
    Descriptor as Descriptor,
    describe as describe,
    r_bihdm as r_bihdm,
    shape_dna as shape_dna,
)
from .errors import (
    BenchmarkError as BenchmarkError,
    CatalogueError as CatalogueError,
    DegenerateMeshError as DegenerateMeshError,
    InputError as InputError,
    MemoryExceeded as MemoryExceeded,
    OptionError as OptionError,
    PcretrieveError as PcretrieveError,
    ReconstructionError as ReconstructionError,
    RemeshError as RemeshError,
    ScanReadError as ScanReadError,
    ShapeError as ShapeError,
    SpectrumError as SpectrumError,
    StageTimeout as StageTimeout,
    UnexpectedError as UnexpectedError,
    WorkerDied as WorkerDied,
)
from .estimators import (
    NeighbourWhitening as NeighbourWhitening,
    PCAWhitening as PCAWhitening,
    PeopleWhitening as PeopleWhitening,
    SignatureNeighbors as SignatureNeighbors,
    SignatureTransformer as SignatureTransformer,
    WithinClassWhitening as WithinClassWhitening,
)
from .evaluation import (
    Comparison as Comparison,
    Evaluation as Evaluation,
    Evaluations as Evaluations,
    RetrievalMeasures as RetrievalMeasures,
    calibrate as calibrate,
    compare as compare,
    evaluate as evaluate,
    evaluate_methods as evaluate_methods,
    matrix as matrix,
)
from .formats import (
    read_scan as read_scan,
    write_cloud as write_cloud,
    write_mesh as write_mesh,
)
from .gallery.answers import (
    Answer as Answer,
    search as search,
    search_many as search_many,
)
from .gallery.fitted import (
    compare_measures as compare_measures,
    index as index,
    signatures as signatures,
    stored_measures as stored_measures,
    stored_signature as stored_signature,
)
from .gallery.groups import (
    NearPair as NearPair,
    cluster as cluster,
    copies as copies,
    duplicates as duplicates,
    places as places,
)
from .ingestion.cluster import DaskExecutor as DaskExecutor
from .ingestion.problems import report_problem as report_problem
from .ingestion.progress import BatchStatus as BatchStatus, status as status
from .ingestion.recomputing import Check as Check, check as check
from .ingestion.run import (
    Summary as Summary,
    ingest as ingest,
    retry as retry,
    watch as watch,
)
from .ingestion.scans import map_scans as map_scans
from .ingestion.views import merge_views as merge_views
from .options import MergeOptions as MergeOptions, PipelineOptions as PipelineOptions
from .pages.inspection_page import inspect as inspect
from .pages.map_page import draw_map as draw_map
from .pages.queries_page import (
    duplicates_page as duplicates_page,
    query_page as query_page,
)
from .pages.retrieval_page import report as report
from .pipeline.process import (
    clean as clean,
    crop as crop,
    orient as orient,
    process as process,
    reconstruct as reconstruct,
    signature as signature,
)
from .retrieval import (
    DistanceMatrix as DistanceMatrix,
    SignatureIndex as SignatureIndex,
    Whitening as Whitening,
    read_matrix as read_matrix,
    write_matrix as write_matrix,
)
from .spectral import eigenpairs as eigenpairs, laplace_beltrami as laplace_beltrami
from .values import (
    Eigenpairs as Eigenpairs,
    Grade as Grade,
    LaplaceBeltrami as LaplaceBeltrami,
    ModalSpectrum as ModalSpectrum,
    Neighbors as Neighbors,
    PointCloud as PointCloud,
    Shape as Shape,
    Signature as Signature,
    SignatureTable as SignatureTable,
    Step as Step,
    Surface as Surface,
    TriangleMesh as TriangleMesh,
)
from .values.signatures import write_signatures as write_signatures
from .web import serve as serve

__all__: list[str]
__version__: str
