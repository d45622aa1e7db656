"""The parameters of the pipeline: one frozen options class for each stage, nested in `PipelineOptions`.

Options are read from TOML, validated when an object is made, and identified by a digest. Lengths are relative
to the diagonal of the axis-aligned bounding box of the points ("the diagonal"), unless the description of the
option names another unit, so that the signature of a scan does not depend on the unit of its file. The
measurements behind the default values are in docs/decisions.md.
"""

from pcretrieve.options.pipeline import (
    JUDGED,
    NUMBERS_VERSION,
    PRESETS,
    OptionsLike,
    PipelineOptions,
    check_many,
    describe_options,
    options_difference,
)
from pcretrieve.options.tables import (
    CatalogueOptions,
    MergeOptions,
    Options,
    RemeshOptions,
    RerankKind,
    RetrievalOptions,
    Scale,
    ScanOptions,
    Shrinkage,
    SignatureOptions,
    SpectralOptions,
    SurfaceOptions,
    WhiteningKind,
    fused_names,
)

__all__ = [
    "JUDGED",
    "NUMBERS_VERSION",
    "PRESETS",
    "CatalogueOptions",
    "MergeOptions",
    "Options",
    "OptionsLike",
    "PipelineOptions",
    "RemeshOptions",
    "RerankKind",
    "RetrievalOptions",
    "Scale",
    "ScanOptions",
    "Shrinkage",
    "SignatureOptions",
    "SpectralOptions",
    "SurfaceOptions",
    "WhiteningKind",
    "check_many",
    "describe_options",
    "fused_names",
    "options_difference",
]
