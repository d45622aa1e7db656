"""Every number of the pipeline: one frozen options class per stage, nested in `PipelineOptions`.

Lengths are relative to the bounding-box diagonal of the points unless their description names another unit,
so that one scan in millimetres and in metres gives one signature. TOML in, digest out.
"""

from __future__ import annotations

import hashlib
import json
import sys
from importlib.metadata import entry_points
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from pcretrieve.errors import OptionError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

__all__ = [
    "MergeOptions",
    "PipelineOptions",
    "RemeshOptions",
    "ScanOptions",
    "SignatureOptions",
    "SpectralOptions",
    "SurfaceOptions",
    "describe_options",
    "options_difference",
    "signature_methods",
]

# Raised whenever the code, rather than an option, moves a signature: old catalogues must not mix with new
# numbers. CHANGELOG, "Changed numbers", says what moved.
NUMBERS_VERSION = 7

Share = Annotated[float, Field(ge=0, le=1)]
Length = Annotated[float, Field(ge=0, lt=1)]
Count = Annotated[int, Field(ge=1)]


class _Options(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True)

    def __init__(self, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise OptionError(_explain(error)) from error


class ScanOptions(_Options):
    """Raw points → clean points with normals that point outwards."""

    voxel: Literal["auto"] | Length = "auto"
    """Edge of the voxels in which points are averaged; relative to the diagonal, 0 keeps all. auto: .003 for
    dense clouds, .0015 for others."""
    outlier_neighbors: Count = 20
    """Neighbours whose mean distance marks a stray point; points."""
    outlier_std: Annotated[float, Field(gt=0)] = 2.0
    """How unusual that distance may be; standard deviations over the cloud."""
    normal_neighbors: Annotated[int, Field(ge=3)] = 16
    """Neighbours that a normal is fitted to; points."""
    orientation: Literal["auto", "viewpoint", "flood", "tangent-plane", "given"] = "auto"
    """Where normals get their sign: the sensors' positions, a flood of the outside, tangent planes, or the
    file's own (given). auto: sensors where the file has them, else its own normals, else flood."""
    flood_cell: Annotated[float, Field(gt=0, lt=0.1)] = 0.005
    """Edge of the cells that the outside is flooded through; relative to the diagonal. Never less than 1.3
    spacings of the points."""
    flood_gap: Length = 0.02
    """Radius of the largest hole that the flood is kept out of at first; relative to the diagonal."""
    flood_retries: Annotated[int, Field(ge=0, le=10)] = 4
    """How often a flood that leaked inside is tried again with wider gaps shut."""


class MergeOptions(_Options):
    """Range scans without poses → one cloud. Lengths are relative to the median diagonal of the views, after
    their background is gone; it happens before the pipeline, and is no part of it."""

    refine: bool = True
    """Move views whose poses are given so that their surfaces meet."""
    sensor: Literal["front", "origin"] = "front"
    """Where the sensor of a view is that names none: far out on the z axis of its frame, as range scanners
    write them, or at its origin, as depth cameras do."""
    max_range: Annotated[float, Field(gt=0)] | None = None
    """Distance from the sensor beyond which points are background; unit of the file."""
    keep_largest: bool = False
    """Drop all but the largest connected piece of each view as background."""
    piece_gap: Annotated[float, Field(gt=0, lt=1)] = 0.02
    """Gap that parts two pieces; relative to the diagonal of the view."""
    voxel: Length = 0.0
    """Points of the merged cloud closer than this are one, 0 keeps all."""
    cell: Annotated[float, Field(gt=0, lt=0.1)] = 0.012
    """Points that views are matched by: one in each cell of this edge."""
    n_tries: Annotated[int, Field(ge=1000)] = 200_000
    """Pairs of matching points that are tried for each two views; pairs."""
    n_candidates: Count = 12
    """Different motions of one view onto another that are refined and judged."""
    reach: Annotated[float, Field(gt=0, lt=0.1)] = 0.01
    """Distance within which points of two views are one surface."""
    min_overlap: Share = 0.1
    """Surface that a view must share with the others; share of its points."""
    max_contradiction: Share = 0.02
    """Points of views that may lie where others saw through; relative to those that others saw too."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Of the random tries."""


class SurfaceOptions(_Options):
    """Clean points → closed surface."""

    mode: Literal["auto", "reconstruct", "keep"] = "auto"
    """What is done with a mesh: auto keeps a closed manifold one and reconstructs others, reconstruct always
    does, keep never."""
    method: Literal["growth", "poisson"] = "growth"
    """How points become a surface. growth: the body that they enclose, grown on a grid with the genus asked
    for, closed and manifold in every case. poisson: Open3D's Poisson surface as it comes."""
    genus: Literal["auto", "sphere", "free"] | Annotated[int, Field(ge=0)] = "auto"
    """Handles that growth leaves: none (sphere), a number, all that the points suggest (free), or those as
    thick as the body round them (auto)."""
    cell: Literal["auto"] | Annotated[float, Field(gt=0, lt=0.1)] = "auto"
    """Edge of the cells that the body is grown of; relative to the diagonal. auto: .0033 to .0045, by the
    noise of the points. Never less than the spacing of the points."""
    gap: Length = 0.02
    """Radius of the largest hole in the scan that growth keeps the outside out of; relative to the
    diagonal."""
    bridge: Length = 0.08
    """Widest gap that a piece cut off by a hole is joined to the body across; relative to the diagonal."""
    reconstructions: Count = 2
    """Surfaces that growth makes of one scan, of cells of this size, a third larger, a quarter smaller, and
    so on in turn. The signature is the mean of theirs, and what they differ by is its error bar; surfaces."""
    fill_depth: Annotated[int, Field(ge=4, le=12)] = 6
    """Depth of the Poisson octree that growth fills holes from."""
    poisson_depth: Annotated[int, Field(ge=4, le=12)] = 7
    """Depth of the octree of the method poisson; the finest cell is scale · longest side / 2^depth."""
    poisson_scale: Annotated[float, Field(ge=1)] = 1.1
    """Side of the Poisson cube; relative to the longest side of the bounding box."""
    density_trim: Share = 0.0
    """Surface with the least support that the method poisson cuts before remeshing; share of its vertices."""
    target_faces: Annotated[int, Field(ge=200)] = 10_000
    """Size that the surface is simplified to; faces."""
    sample_points: Annotated[int, Field(ge=100)] = 30_000
    """Points that a mesh with defects is sampled by before it is reconstructed; points."""
    max_discarded: Share = 0.1
    """Largest second piece that is dropped in favour of the first; share of the points (growth) or of the
    area (poisson). A larger one is another body, and an error."""


class RemeshOptions(_Options):
    """Closed surface → clean surface, by way of tetrahedra (fTetWild)."""

    method: Literal["none", "tetwild"] = "none"
    """The remesher. Growth gives a closed manifold by itself."""
    edge_length: Annotated[float, Field(gt=0, lt=1)] = 0.05
    """Ideal edge of the tetrahedra; relative to the diagonal."""
    envelope: Annotated[float, Field(gt=0, lt=0.1)] = 0.001
    """How far the surface may move; relative to the diagonal."""
    optimize: bool = False
    """Improve the tetrahedra inside. Ten times slower, and the surface's signature does not gain."""
    timeout: Annotated[float, Field(gt=0)] = 60.0
    """When the remesher is killed and its input used instead; seconds."""
    max_change: Share = 0.1
    """Change of area or volume beyond which its answer is refused and its input used instead; relative."""


class SpectralOptions(_Options):
    """Surface of unit area → lowest eigenpairs of its Laplace–Beltrami operator."""

    element: Literal["linear", "cubic", "intrinsic-delaunay", "points"] = "linear"
    """How the operator is discretised: linear or cubic finite elements; linear ones on the intrinsic Delaunay
    triangulation of the surface, which stands bad and non-manifold triangles; or linear ones on the cleaned
    points (points), with no surface made at all."""
    n_pairs: Annotated[int, Field(ge=3)] = 61
    """Eigenpairs that are computed and kept, the constant one included; pairs."""


# Descriptors that come with pcretrieve, and those of them that have no size to keep.
METHODS = (
    "r-bihdm",
    "bihdm",
    "shape-dna",
    "shape-dna-norm1",
    "sd-gdm",
    "hks-bow",
    "hks-bow-spatial",
    "si-hks-bow",
    "si-hks-bow-spatial",
    "wks",
    "combined",
)
SIZELESS = {name for name in METHODS if "hks" in name} | {"wks", "shape-dna-norm1"}

# The entry points by which other packages add descriptors.
PLUGIN_GROUP = "pcretrieve.signatures"


def signature_methods() -> tuple[str, ...]:
    """The names of all descriptors: pcretrieve's own, then those of other packages by name."""
    added = {point.name for point in entry_points(group=PLUGIN_GROUP)}
    return (*METHODS, *sorted(added.difference(METHODS)))


Scale = Literal["relative", "area", "absolute"]


class SignatureOptions(_Options):
    """Spectrum and surface → descriptor."""

    method: str = "r-bihdm"
    """The descriptor; `pcretrieve signature --help` lists them all."""
    n_values: Count = 23
    """Length L of the descriptor; values. Of combined, of each half; of bags of features, their words."""
    n_modes: Annotated[int, Field(ge=2)] = 60
    """Modes m that R-BiHDM, BiHDM, heat and wave kernels are cut at; modes."""
    scale: Scale = "area"
    """What values are measured by: the area of the surface (area), the descriptor's own first one (relative,
    as the papers do), or the unit of the file (absolute). The first two are the same for bodies of one form
    and two sizes; the last needs files of one unit, which in most collections they are not. R-BiHDM retrieves
    better by area, but relative where many values are PCA whitened."""
    size_weight: Annotated[float, Field(ge=0, le=20)] = 0.0
    """Weight of the size of bodies beside their form: the descriptor gets one value more, the area of the
    surface to this power. 0 leaves size out; with 6, bodies whose areas are a sixth apart are 1 apart. Like
    the scale absolute it needs files of one unit, and it is the better of the two."""

    @field_validator("method")
    @classmethod
    def _exists(cls, method: str) -> str:
        if method not in METHODS and method not in (names := signature_methods()):
            raise ValueError(f"input should be one of {', '.join(names)}, got {method!r}")
        return method

    @model_validator(mode="after")
    def _has_a_size(self) -> SignatureOptions:
        if self.scale == "absolute" and self.method in SIZELESS:
            raise ValueError(
                f"scale: must be area or relative for {self.method}, which has no size to keep; absolute is "
                "for " + ", ".join(name for name in METHODS if name not in SIZELESS)
            )
        return self


class PipelineOptions(_Options):
    """All of them. `PipelineOptions()` is the measured default."""

    scan: ScanOptions = ScanOptions()
    surface: SurfaceOptions = SurfaceOptions()
    remesh: RemeshOptions = RemeshOptions()
    spectral: SpectralOptions = SpectralOptions()
    signature: SignatureOptions = SignatureOptions()

    @classmethod
    def from_toml(cls, path: str | Path) -> PipelineOptions:
        """Options from a TOML file with one table per stage; what it does not name keeps its default.

        Raises
        ------
        OptionError
            Where the file cannot be read, is not TOML, or names an option or a value that does not exist.
        """
        try:
            values = tomllib.loads(Path(path).read_text(encoding="utf-8"))
        except OSError as error:
            raise OptionError(f"cannot read the options file {path}: {error.strerror}") from error
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise OptionError(f"{path} is not valid TOML: {error}") from error
        try:
            return cls(**values)
        except OptionError as error:
            raise OptionError(f"{path}: {error.message}") from error

    @classmethod
    def preset(cls, name: str) -> PipelineOptions:
        """The options for a common source of scans, by name: one of `PRESETS`.

        Raises
        ------
        OptionError
            If there is no such preset.
        """
        if name not in PRESETS:
            raise OptionError(f"there is no preset {name!r}; there are {', '.join(PRESETS)}")
        return cls(**PRESETS[name])

    def changed(self, **stages: dict[str, Any]) -> PipelineOptions:
        """These options with some replaced: ``options.changed(surface={"mode": "keep"})``."""
        values = self.model_dump()
        for stage, changes in stages.items():
            values.setdefault(stage, {}).update(changes)
        return type(self)(**values)

    @property
    def digest(self) -> str:
        """Fingerprint of everything that moves a stored spectrum: 16 hexadecimal digits.

        `signature` is left out: signatures are computed anew from the stored spectrum, so one catalogue
        serves every method and length.
        """
        values = self.model_dump(exclude={"signature"})
        values["numbers_version"] = NUMBERS_VERSION
        return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()[:16]

    @property
    def signature_digest(self) -> str:
        """Fingerprint of everything that moves a signature: only those that agree in it compare."""
        return hashlib.sha256((self.digest + self.signature.model_dump_json()).encode()).hexdigest()[:16]


# What differs from the default for scans of a common source.
PRESETS: dict[str, dict[str, dict[str, Any]]] = {
    # A ring of cameras round a person, who has no handles: wherever limbs touch they are cut apart. All scans
    # have the scanner's unit, so that size tells people apart too. mAP of ten simulated people by form .893,
    # with the size at the weights 3, 6 and 9.6 .912, .931, .925, and with volume^(2/3) at 6 .896; by the
    # absolute spectrum alone .872.
    "body-scanner": {"surface": {"genus": "sphere"}, "signature": {"size_weight": 6.0}},
    # Walked round by hand: strays, and holes wherever the walk did not lead. TOSCA from everywhere, 40 000
    # points, noise .0015, ten holes of radius .03, 2 % strays: median log-signature error .63 -> .58, mAP
    # .692 -> .712; but .765 -> .756 where nine cameras leave few holes.
    "handheld": {
        "scan": {"outlier_std": 1.5, "flood_gap": 0.03},
        "surface": {"gap": 0.03},
    },
    # Frames of a depth sensor: noise of a third of a per cent and more. Every second mesh of TOSCA seen by
    # nine cameras, 60 000 points, noise .005: median log-signature error 1.63 -> .82, mAP .538 -> .637, in
    # 2.1 s instead of 3.7 s; with noise of .003 and 20 000 points mAP .703 -> .687.
    "depth-camera": {
        "scan": {"voxel": 0.004, "outlier_std": 1.5, "normal_neighbors": 30, "flood_gap": 0.03},
        "surface": {"cell": 0.006, "gap": 0.03},
    },
    # Modelled, or cleaned by hand: taken as they are, but for repairs.
    "clean-mesh": {"surface": {"mode": "keep"}},
}


def options_difference(theirs: PipelineOptions, ours: PipelineOptions) -> list[str]:
    """One line for each option that differs: ``surface.poisson_depth: 7 there, 8 here``."""
    there, here = theirs.model_dump(), ours.model_dump()
    return [
        f"{stage}.{name}: {there[stage][name]!r} there, {here[stage][name]!r} here"
        for stage in there
        for name in there[stage]
        if there[stage][name] != here[stage][name]
    ]


def describe_options(options: PipelineOptions) -> str:
    """The options as commented TOML, ready to be edited and passed to ``--config``."""
    lines = []
    for stage in type(options).model_fields:
        group: _Options = getattr(options, stage)
        lines += [f"# {group.__doc__}", f"[{stage}]"]
        for name, info in type(group).model_fields.items():
            lines += [f"# {line}" for line in (info.description or "").splitlines()]
            lines += [f"{name} = {json.dumps(getattr(group, name))}"]
        lines.append("")
    return "\n".join(lines)


TYPES_TRIED = ("literal['auto','sphere','free']", "literal['auto']", "constrained-int", "constrained-float")


def _explain(error: ValidationError) -> str:
    """What must hold and what was given, one clause for each bad option."""
    clauses = []
    for problem in error.errors():
        # Of an option that may be one of several types, pydantic names the type too.
        name = ".".join(str(part) for part in problem["loc"] if part not in TYPES_TRIED)
        cause = problem.get("ctx", {}).get("error")
        if isinstance(cause, OptionError):
            clauses.append(f"in [{name}], {cause.message}")
        elif problem["type"] == "value_error":
            clauses.append(f"{name}: {cause}" if name else str(cause))
        elif problem["type"] == "extra_forbidden":
            clauses.append(f"there is no option {name!r}; `pcretrieve options` lists them all")
        else:
            clauses.append(
                f"{name}: {problem['msg'][0].lower()}{problem['msg'][1:]}, got {problem['input']!r}"
            )
    return "; ".join(clauses)
