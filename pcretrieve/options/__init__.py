"""The parameters of the pipeline: one frozen options class for each stage, nested in `PipelineOptions`.

Options are read from TOML, validated when an object is made, and identified by a digest. Lengths are relative
to the diagonal of the axis-aligned bounding box of the points ("the diagonal"), unless the description of the
option names another unit, so that the signature of a scan does not depend on the unit of its file. The
measurements behind the default values are in docs/decisions.md.
"""

from pcretrieve.options.catalogue import CatalogueOptions
from pcretrieve.options.description import describe_options, options_difference
from pcretrieve.options.filters import PointFilter, SurfaceFilter
from pcretrieve.options.merge import MergeOptions
from pcretrieve.options.model import Options
from pcretrieve.options.pipeline import NUMBERS_VERSION, OptionsLike, PipelineOptions
from pcretrieve.options.presets import PRESETS
from pcretrieve.options.retrieval import RerankKind, RetrievalOptions, Shrinkage, WhiteningKind
from pcretrieve.options.scan import ScanOptions
from pcretrieve.options.signature import Scale, SignatureOptions, SpectralOptions
from pcretrieve.options.stages import DEFAULT_STAGES, StageOptions, check_chain, link_of
from pcretrieve.options.surface import RemeshOptions, SurfaceOptions

__all__ = [
    "DEFAULT_STAGES",
    "NUMBERS_VERSION",
    "PRESETS",
    "CatalogueOptions",
    "MergeOptions",
    "Options",
    "OptionsLike",
    "PipelineOptions",
    "PointFilter",
    "RemeshOptions",
    "RerankKind",
    "RetrievalOptions",
    "Scale",
    "ScanOptions",
    "Shrinkage",
    "SignatureOptions",
    "SpectralOptions",
    "StageOptions",
    "SurfaceFilter",
    "SurfaceOptions",
    "WhiteningKind",
    "check_chain",
    "describe_options",
    "link_of",
    "options_difference",
]
