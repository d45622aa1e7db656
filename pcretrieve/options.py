"""The parameters of the pipeline: one frozen options class for each stage, nested in `PipelineOptions`.

Options are read from TOML, validated when an object is made, and identified by a digest. Lengths are relative
to the diagonal of the axis-aligned bounding box of the points ("the diagonal"), unless the description of the
option names another unit, so that the signature of a scan does not depend on the unit of its file. The
measurements behind the default values are in docs/decisions.md.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from pcretrieve.errors import OptionError
from pcretrieve.names import METHODS, NAMES

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

__all__ = [
    "MergeOptions",
    "OptionsLike",
    "PipelineOptions",
    "RemeshOptions",
    "RetrievalOptions",
    "ScanOptions",
    "SignatureOptions",
    "SpectralOptions",
    "SurfaceOptions",
    "describe_options",
    "options_difference",
]

# Version of the numerical results, part of the digest. It is incremented when a change of the code, not of an
# option, changes a signature, because signatures of different versions must not be compared. The changes are
# listed in CHANGELOG.md under "Changed numbers".
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
    """Raw points → filtered points with normals that point outwards."""

    voxel: Literal["auto"] | Length = "auto"
    """Edge of the voxels in which points are averaged (voxel-grid filter); relative to the diagonal, 0 for no
    filter. auto: .003 for dense clouds, .0015 for others."""
    outlier_neighbors: Count = 20
    """Statistical outlier removal: number of neighbours to which the mean distance of a point is computed."""
    outlier_std: Annotated[float, Field(gt=0)] = 2.0
    """Statistical outlier removal: largest mean distance that is kept; standard deviations above the mean of
    the cloud."""
    normal_neighbors: Annotated[int, Field(ge=3)] = 16
    """Number of neighbours to which the tangent plane of a point is fitted."""
    orientation: Literal["auto", "viewpoint", "flood", "tangent-plane", "given"] = "auto"
    """How the sign of normals is found. viewpoint: towards the sensor; flood: towards the outside, found by
    flood fill; tangent-plane: consistently along a minimum spanning tree; given: the normals in the file.
    auto: viewpoint if the file has sensor positions, else given if it has normals, else flood."""
    flood_cell: Annotated[float, Field(gt=0, lt=0.1)] = 0.005
    """Edge of the grid cells of the flood fill; relative to the diagonal. At least 1.3 times the spacing of
    the points."""
    flood_gap: Length = 0.02
    """Radius of the largest hole in the scan through which the flood fill does not pass, at the first
    attempt; relative to the diagonal."""
    flood_retries: Annotated[int, Field(ge=0, le=10)] = 4
    """Number of further attempts, each with a larger radius, if the flood fill leaks into the body."""


class MergeOptions(_Options):
    """Range scans (views), with or without poses → one cloud in one frame, before the pipeline.

    Lengths called relative are relative to the median bounding-box diagonal of the views without background.
    """

    refine: bool = True
    """Refine given poses by registration."""
    sensor: Literal["front", "origin"] = "front"
    """Position of the sensor of a view whose file has none. front: far along the z axis of the frame of the
    view, the convention of range scanners; origin: at its origin, the convention of depth cameras."""
    max_range: Annotated[float, Field(gt=0)] | None = None
    """Distance from the sensor beyond which points are removed as background; unit of the file."""
    keep_largest: bool = False
    """Remove all but the largest connected component of each view as background."""
    piece_gap: Annotated[float, Field(gt=0, lt=1)] = 0.02
    """Distance between points above which they are in different components; relative to the diagonal of the
    view."""
    voxel: Length = 0.0
    """Edge of the voxels in which points of the merged cloud are averaged, 0 for no averaging; relative."""
    cell: Annotated[float, Field(gt=0, lt=0.1)] = 0.012
    """Edge of the voxels of which each gives one point to the matching of features; relative."""
    n_tries: Annotated[int, Field(ge=1000)] = 200_000
    """Number of random samples of point correspondences for each pair of views."""
    n_candidates: Count = 12
    """Number of distinct rigid motions for each pair of views that are refined and verified."""
    reach: Annotated[float, Field(gt=0, lt=0.1)] = 0.01
    """Largest distance between corresponding points of two registered views; relative."""
    min_overlap: Share = 0.1
    """Smallest overlap of a view with the other views; fraction of its points."""
    max_contradiction: Share = 0.02
    """Largest number of points of a view that lie in space which another view observed as empty; relative to
    the number of points in the overlap."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of the random samples."""


# The options that one method of surface reconstruction alone uses. `reconstructions` is not here: that the
# method poisson makes one surface is noted for the default too.
ONLY_OF_METHOD = {
    "growth": ("genus", "cell", "gap", "bridge", "fill_depth"),
    "poisson": ("poisson_depth", "poisson_scale", "density_trim"),
}


class SurfaceOptions(_Options):
    """Filtered points with normals → closed surface."""

    mode: Literal["auto", "reconstruct", "keep"] = "auto"
    """What is done if the input is a mesh. auto: reconstruct it unless it is closed and manifold;
    reconstruct: always; keep: never."""
    method: Annotated[str, AfterValidator(NAMES["surface method"].known)] = "growth"
    """The method of surface reconstruction. growth: topology-preserving region growing on a voxel grid, which
    gives a closed manifold surface of the genus below; poisson: screened Poisson reconstruction by Open3D.
    Other packages can add methods."""
    genus: Literal["auto", "sphere", "free"] | Annotated[int, Field(ge=0)] = "auto"
    """Genus, the number of handles, of the surface by growth. sphere: 0; a number: that number; free:
    whatever the points suggest; auto: only handles about as thick as the body."""
    cell: Literal["auto"] | Annotated[float, Field(gt=0, lt=0.1)] = "auto"
    """Edge of the voxels of growth; relative to the diagonal. auto: .0033 to .0045, by the noise of the
    points. At least the spacing of the points."""
    gap: Length = 0.02
    """Radius of the largest hole in the scan that growth closes against the outside; relative to the
    diagonal."""
    bridge: Length = 0.08
    """Largest distance over which growth connects a component that a hole has separated to the body; relative
    to the diagonal."""
    reconstructions: Count = 2
    """Number of surfaces that growth reconstructs from one scan, with voxels of the edge above, 4/3 of it,
    3/4 of it, and so on in turn. The signature is the geometric mean over the surfaces, and its error bar is
    the standard deviation over them."""
    fill_depth: Annotated[int, Field(ge=4, le=12)] = 6
    """Octree depth of the Poisson surface by which growth fills holes."""
    poisson_depth: Annotated[int, Field(ge=4, le=12)] = 7
    """Octree depth of the method poisson; its smallest cell is poisson_scale · longest side / 2^depth."""
    poisson_scale: Annotated[float, Field(ge=1)] = 1.1
    """Side of the cube of the method poisson; relative to the longest side of the bounding box."""
    density_trim: Share = 0.0
    """Fraction of the vertices, those with the lowest point density, that the method poisson removes before
    remeshing."""
    target_faces: Annotated[int, Field(ge=200)] = 10_000
    """Largest number of faces after simplification."""
    sample_points: Annotated[int, Field(ge=100)] = 30_000
    """Number of points sampled on a mesh with defects before it is reconstructed."""
    max_discarded: Share = 0.1
    """Largest size of a second connected component that is removed; fraction of the points (growth) or of the
    area (poisson). A larger component is a second body, and an error."""

    @property
    def unused(self) -> tuple[str, ...]:
        """The options with other values than the defaults that the method does not use, such as surface.gap.

        They are noted in the provenance and are no error, because a preset for a source of scans may name
        options of both methods.
        """
        return tuple(
            f"surface.{name}"
            for method, names in ONLY_OF_METHOD.items()
            for name in names
            if method != self.method and getattr(self, name) != type(self).model_fields[name].default
        )


class RemeshOptions(_Options):
    """Closed surface → boundary of a tetrahedral mesh (fTetWild)."""

    method: Literal["none", "tetwild"] = "none"
    """The remesher. The surface method growth needs none, because its surface is a closed manifold."""
    edge_length: Annotated[float, Field(gt=0, lt=1)] = 0.05
    """Ideal edge length of the tetrahedra; relative to the diagonal."""
    envelope: Annotated[float, Field(gt=0, lt=0.1)] = 0.001
    """Largest distance of the new surface from the old one; relative to the diagonal."""
    optimize: bool = False
    """Optimise the quality of the tetrahedra. Slow, without benefit for the signature of the surface."""
    timeout: Annotated[float, Field(gt=0)] = 60.0
    """Time limit; seconds. After it the surface is used as it was before remeshing."""
    max_change: Share = 0.1
    """Largest relative change of area or volume. Beyond it the surface is used as it was before remeshing."""


class SpectralOptions(_Options):
    """Surface of unit area → smallest eigenpairs of its Laplace–Beltrami operator."""

    element: Annotated[str, AfterValidator(NAMES["element"].known)] = "linear"
    """Discretisation of the operator. linear, cubic: finite elements on the triangles of the surface;
    intrinsic-delaunay: linear elements on the intrinsic Delaunay triangulation of the tufted cover, robust to
    badly shaped and non-manifold triangles; points: linear elements on local triangulations of the filtered
    points, without a surface."""
    n_pairs: Annotated[int, Field(ge=3)] = 61
    """Number of eigenpairs that are computed and stored, including the constant eigenfunction."""


Scale = Literal["relative", "area", "absolute"]


class SignatureOptions(_Options):
    """Spectrum and surface → descriptor."""

    method: Annotated[str, AfterValidator(NAMES["descriptor"].known)] = "r-bihdm"
    """The descriptor; `pcretrieve signature --help` lists all of them."""
    n_values: Count = 23
    """Number L of values of the descriptor. For combined, of each of its two parts; for bags of features, the
    number of words."""
    n_modes: Annotated[int, Field(ge=2)] = 60
    """Number m of modes at which R-BiHDM, BiHDM, and the heat and wave kernels are truncated."""
    scale: Literal["auto", "relative", "area", "absolute"] = "auto"
    """Normalisation of the values: by the area of the surface (area), by the first value of the descriptor
    (relative, as in the papers), or none (absolute). area and relative are invariant to scaling; absolute
    compares sizes too, and is meaningful only if all files are in one unit. auto: relative if signatures are
    compared after PCA whitening, area otherwise, which for R-BiHDM gives the better rankings."""
    size_weight: Annotated[float, Field(ge=0, le=20)] = 0.0
    """Weight w of the size of a body relative to its form: area^w is appended to the values, if w > 0. In log
    distances, bodies whose areas differ by a factor of exp(1/w) are then 1 apart. Meaningful only if all
    files are in one unit. Gives better rankings than the scale absolute."""

    @property
    def measured_by(self) -> Scale:
        """The normalisation of a signature by itself: `scale`, with area for auto."""
        return "area" if self.scale == "auto" else self.scale

    @model_validator(mode="after")
    def _has_a_size(self) -> SignatureOptions:
        if self.scale == "absolute" and not METHODS.get(self.method, True):
            raise ValueError(
                f"scale: must be area or relative for {self.method}, which has no size to keep; absolute is "
                "for " + ", ".join(name for name, has_size in METHODS.items() if has_size)
            )
        return self


WhiteningKind = Literal["none", "resolution", "pca", "within-class"]
Damping = Literal["auto"] | Annotated[float, Field(gt=0, le=1)]


class RetrievalOptions(_Options):
    """Signatures → ranked shapes. No stored spectrum or signature depends on these options."""

    distance: Annotated[str, AfterValidator(NAMES["distance"].known)] = "log"
    """Distance of two signatures: the Euclidean distance of their logarithms (log), or the dissimilarities D1
    and D2 of Ye and Yu."""
    whitening: WhiteningKind = "none"
    """Linear map of log-signatures before they are compared: none; the whitening of the changes that the
    resolution of a surface causes, measured on simulated bodies (resolution, for r-bihdm only); or that of
    the covariance of the gallery (pca), or of its pooled within-class covariance (within-class)."""
    damping: Damping = "auto"
    """Regularisation of the covariance of a whitening: for pca and resolution relative to its largest
    eigenvalue, for within-class the shrinkage intensity. auto: .01, .03 and .1."""
    n_folds: Annotated[int, Field(ge=2)] = 5
    """Number of folds of classes with which a within-class whitening is evaluated."""
    fold_seed: Annotated[int, Field(ge=0)] = 0
    """Seed of the random assignment of classes to folds."""


#: What public functions take for options: see `PipelineOptions.of`.
OptionsLike: TypeAlias = "PipelineOptions | Mapping[str, Any] | str | Path | None"


class PipelineOptions(_Options):
    """The options of all stages. `PipelineOptions()` are the defaults; docs/decisions.md has the reasons."""

    scan: ScanOptions = ScanOptions()
    surface: SurfaceOptions = SurfaceOptions()
    remesh: RemeshOptions = RemeshOptions()
    spectral: SpectralOptions = SpectralOptions()
    signature: SignatureOptions = SignatureOptions()
    retrieval: RetrievalOptions = RetrievalOptions()

    @classmethod
    def from_toml(cls, path: str | Path, base: PipelineOptions | None = None) -> PipelineOptions:
        """Read options from a TOML file with one table for each stage.

        Parameters
        ----------
        path : str or Path
            The file.
        base : PipelineOptions, optional
            The values of options that the file does not name, such as those of a catalogue. By default the
            defaults.

        Returns
        -------
        PipelineOptions
            The options in the file, and those of `base`.

        Raises
        ------
        OptionError
            If the file cannot be read, is not TOML, or has an unknown option or an invalid value.
        """
        try:
            values = tomllib.loads(Path(path).read_text(encoding="utf-8"))
        except OSError as error:
            raise OptionError(f"cannot read the options file {path}: {error.strerror}") from error
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise OptionError(f"{path} is not valid TOML: {error}") from error
        try:
            return (base or cls()).changed(**values)
        except OptionError as error:
            raise OptionError(f"{path}: {error.message}") from error

    @classmethod
    def preset(cls, name: str, base: PipelineOptions | None = None) -> PipelineOptions:
        """The options for a common source of scans.

        Parameters
        ----------
        name : str
            A key of `PRESETS`.
        base : PipelineOptions, optional
            The values of options that the preset does not name. By default the defaults.

        Returns
        -------
        PipelineOptions
            The options of `base` with the changes of the preset.

        #: What public functions take for options: see `PipelineOptions.of`.
        OptionsLike: TypeAlias = "PipelineOptions | Mapping[str, Any] | str | Path | None"

        Raises
        ------
        OptionError
            If there is no preset of this name.
        """
        if name not in PRESETS:
            raise OptionError(f"there is no preset {name!r}; there are {', '.join(PRESETS)}")
        return (base or cls()).changed(**PRESETS[name])

    @classmethod
    def named(cls, name: str | Path, base: PipelineOptions | None = None) -> PipelineOptions:
        """The options of a TOML file, or of a preset if there is no file of that name.

        Parameters
        ----------
        name : str or Path
            The file, or a key of `PRESETS`.
        base : PipelineOptions, optional
            The values of options that the file or the preset does not name. By default the defaults.

        Returns
        -------
        PipelineOptions
            As of `from_toml` or `preset`.

        Raises
        ------
        OptionError
            If there is neither such a file nor such a preset, or the file cannot be read or is invalid.
        """
        if str(name) in PRESETS and not Path(name).exists():
            return cls.preset(str(name), base)
        return cls.from_toml(name, base)

    @classmethod
    def of(cls, options: OptionsLike, base: PipelineOptions | None = None) -> PipelineOptions:
        """The options that a value stands for, as public functions take them.

        Parameters
        ----------
        options : PipelineOptions, mapping, str, Path or None
            Options; a mapping of stages to options with their values, such as ``{"signature": {"n_values":
            45}}``; the name of a preset or of a TOML file; None for `base`.
        base : PipelineOptions, optional
            The values of options that a mapping, a preset or a file does not name. By default the defaults.

        Returns
        -------
        PipelineOptions
            The options themselves, or those named with the rest of `base`.

        Raises
        ------
        OptionError
            If the value stands for no options, or has an unknown option or an invalid value.
        """
        if options is None:
            return base or cls()
        if isinstance(options, cls):
            return options
        if isinstance(options, (str, Path)):
            return cls.named(options, base)
        if isinstance(options, Mapping):
            return (base or cls()).changed(**options)
        raise OptionError(
            "options must be PipelineOptions, a mapping such as {'signature': {'n_values': 45}}, or the name "
            f"of a preset ({', '.join(PRESETS)}) or of a TOML file, got {type(options).__name__}"
        )

    def changed(self, **stages: dict[str, Any]) -> PipelineOptions:
        """A copy with some options replaced, such as ``options.changed(surface={"mode": "keep"})``.

        Parameters
        ----------
        **stages : dict
            For each stage, the options that change and their new values.

        Returns
        -------
        PipelineOptions
            The copy.

        Raises
        ------
        OptionError
            If there is no such option, or its value is not allowed.
        """
        values = self.model_dump()
        for stage, changes in stages.items():
            known = isinstance(changes, dict) and stage in values
            values[stage] = values[stage] | changes if known else changes
        return type(self)(**values)

    @property
    def digest(self) -> str:
        """Hash of everything that a stored spectrum depends on: 16 hexadecimal digits.

        The options of the stages `signature` and `retrieval` are not included, because signatures are
        computed from the stored spectrum on demand: one catalogue serves all methods, numbers of values and
        distances.
        """
        values = self.model_dump(exclude={"signature", "retrieval"})
        values["numbers_version"] = NUMBERS_VERSION
        return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()[:16]

    @property
    def signature_digest(self) -> str:
        """Hash of everything that a signature depends on: signatures are comparable only if it is equal."""
        return self._digest_of(self.signature.measured_by)

    @property
    def compared(self) -> SignatureOptions:
        """The options of the signatures that are compared, with the normalisation that auto stands for."""
        return self.signature.model_copy(update={"scale": self._compared_by})

    @property
    def compared_digest(self) -> str:
        """Hash of everything that the signatures that are compared depend on.

        It differs from `signature_digest` only where the scale auto means another normalisation. A table of
        signatures, the whitening applied to it and a query must have the same one.
        """
        return self._digest_of(self._compared_by)

    @property
    def _compared_by(self) -> Scale:
        if self.signature.scale == "auto" and self.retrieval.whitening == "pca":
            return "relative"
        return self.signature.measured_by

    def _digest_of(self, scale: Scale) -> str:
        signature = self.signature.model_copy(update={"scale": scale}).model_dump_json()
        return hashlib.sha256((self.digest + signature).encode()).hexdigest()[:16]


# The options that differ from the defaults for scans of a common source. The measurements behind each preset
# are in docs/decisions.md, PRESETS.
PRESETS: dict[str, dict[str, dict[str, Any]]] = {
    # A ring of cameras around a person. People have genus 0: handles appear only where limbs touch, and are
    # cut. All scans are in the unit of the scanner, so that sizes are comparable too.
    "body-scanner": {"surface": {"genus": "sphere"}, "signature": {"size_weight": 6.0}},
    # A hand-held scanner moved around the body: many outliers, and large holes in places that it missed.
    "handheld": {
        "scan": {"outlier_std": 1.5, "flood_gap": 0.03},
        "surface": {"gap": 0.03},
    },
    # Frames of a depth sensor: noise of 0.3 % of the diagonal and more.
    "depth-camera": {
        "scan": {"voxel": 0.004, "outlier_std": 1.5, "normal_neighbors": 30, "flood_gap": 0.03},
        "surface": {"cell": 0.006, "gap": 0.03},
    },
    # Meshes from modelling software, or cleaned by hand: repaired, but not reconstructed.
    "clean-mesh": {"surface": {"mode": "keep"}},
}


def options_difference(theirs: PipelineOptions, ours: PipelineOptions) -> list[str]:
    """The options of what a catalogue stores, retrieval therefore left out, in which two sets differ.

    Parameters
    ----------
    theirs : PipelineOptions
        The options called "there", such as those of a stored catalogue.
    ours : PipelineOptions
        The options called "here".

    Returns
    -------
    list of str
        One line for each option, such as ``surface.poisson_depth: 7 there, 8 here``.
    """
    there, here = theirs.model_dump(exclude={"retrieval"}), ours.model_dump()
    return [
        f"{stage}.{name}: {there[stage][name]!r} there, {here[stage][name]!r} here"
        for stage in there
        for name in there[stage]
        if there[stage][name] != here[stage][name]
    ]


def describe_options(options: PipelineOptions) -> str:
    """Options as TOML, with the description of each option as a comment, for ``--config``.

    Parameters
    ----------
    options : PipelineOptions
        The options to write.

    Returns
    -------
    str
        A TOML document that `PipelineOptions.from_toml` reads back to equal options.
    """
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
    """What must hold and what was given, one clause for each invalid option."""
    clauses = []
    for problem in error.errors():
        # If an option can have several types, the location in pydantic's error includes the type tried.
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
