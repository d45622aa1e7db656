"""The options of each stage as one frozen class, and their base class."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    field_validator,
    model_validator,
)

from pcretrieve.errors import OptionError, did_you_mean
from pcretrieve.plugins import DESCRIPTOR_NAMES, METHODS

Share = Annotated[float, Field(ge=0, le=1)]
Length = Annotated[float, Field(ge=0, lt=1)]
Count = Annotated[int, Field(ge=1)]


class Options(BaseModel):
    """Immutable parameters with descriptions, validated when an object is made.

    Raises
    ------
    OptionError
        If a value is invalid, or there is no option of that name.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    def __init__(self, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise OptionError(_explain(error)) from error


# How pydantic names a type that it tried, in the location of an error of an option with several types.
TYPES_TRIED = ("literal[", "constrained-int", "constrained-float", "tuple[")


def _explain(error: ValidationError) -> str:
    """What must hold and what was given, one clause for each invalid option."""
    clauses = []
    for problem in error.errors():
        name = ".".join(
            str(part) for part in problem["loc"] if not str(part).startswith(TYPES_TRIED)
        )
        cause = problem.get("ctx", {}).get("error")
        if isinstance(cause, OptionError) and name:
            clauses.append(f"in [{name}], {cause.message}")
        elif problem["type"] == "value_error":
            clauses.append(f"{name}: {cause}" if name else str(cause))
        elif problem["type"] == "extra_forbidden":
            known = [
                one for table in Options.__subclasses__() for one in table.model_fields
            ]
            meant = did_you_mean(name.rpartition(".")[2], known)
            clauses.append(
                f"there is no option {name!r}; `pcretrieve lab options` lists them all{meant}"
            )
        else:
            clauses.append(
                f"{name}: {problem['msg'][0].lower()}{problem['msg'][1:]}, got {problem['input']!r:.200}"
            )
    return "; ".join(clauses)


Corner = tuple[float, float, float]


class ScanOptions(Options):
    """Raw points → points of the body, filtered, with normals that point outwards."""

    unit: Literal["none", "um", "mm", "cm", "dm", "m", "km", "in", "ft"] = "none"
    """Unit of files that name none: um mm cm dm m km in ft; coordinates become metres, as those of other
    files. none: unknown, they stay as they are; metres in LAS files."""
    min_range: Annotated[float, Field(gt=0)] | Literal["none"] = "none"
    """Remove points nearer to the sensor, or to the origin if the file has no sensor positions; unit of the
    file."""
    max_range: Annotated[float, Field(gt=0)] | Literal["none"] = "none"
    """Remove points farther from the sensor, or from the origin; unit of the file."""
    box: tuple[Corner, Corner] | Literal["none"] = "none"
    """Axis-aligned box outside which points are removed: [[x, y, z], [x, y, z]], its lowest and its highest
    corner; unit of the file."""
    ground: Literal["auto", "none"] = "auto"
    """auto: remove the largest plane on which the body stands, if it is seen around the body."""
    keep_largest: bool = False
    """Remove all but the largest connected component."""
    # Distance between points above which they are in different components; relative to the diagonal.
    piece_gap: ClassVar[float] = 0.02
    voxel: Literal["auto"] | Length = "auto"
    """Edge of the voxels in which points are averaged (voxel-grid filter); relative to the diagonal, 0 for no
    filter. auto: .003 for dense clouds, .0015 for others."""
    # Statistical outlier removal: number of neighbours to which the mean distance of a point is computed.
    outlier_neighbors: ClassVar[int] = 20
    outlier_std: Annotated[float, Field(gt=0)] = 2.0
    """Statistical outlier removal: largest mean distance that is kept; standard deviations above the mean of
    the cloud. 1.8 times the median is always kept."""
    normal_neighbors: Annotated[int, Field(ge=3)] = 16
    """Number of neighbours to which the tangent plane of a point is fitted."""
    orientation: Literal["auto", "viewpoint", "flood", "tangent-plane", "given"] = "auto"
    """How the sign of normals is found. viewpoint: towards the sensor; flood: towards the outside, found by
    flood fill; tangent-plane: consistently along a minimum spanning tree; given: the normals in the file.
    auto: viewpoint if the file has sensor positions, else given if it has normals, unless the flood fill
    contradicts them; else flood."""
    # Edge of the grid cells of the flood fill; relative to the diagonal. At least 1.3 times the spacing of
    # the points.
    flood_cell: ClassVar[float] = 0.005
    flood_gap: Length = 0.02
    """Radius of the largest hole in the scan through which the flood fill does not pass, at the first
    attempt; relative to the diagonal."""
    # Number of further attempts, each with a larger radius, if the flood fill leaks into the body.
    flood_retries: ClassVar[int] = 5

    @field_validator("box")
    @classmethod
    def _has_a_volume(
        cls, box: tuple[Corner, Corner] | str
    ) -> tuple[Corner, Corner] | str:
        if not isinstance(box, str) and not all(
            low < high for low, high in zip(*box, strict=True)
        ):
            raise ValueError(
                "input should be the lowest and the highest corner of a box, got "
                f"{[list(corner) for corner in box]}"
            )
        return box


# The options that one method of surface reconstruction alone uses. `reconstructions` is not here: that the
# method poisson makes one surface is noted for the default too.
ONLY_OF_METHOD = {"growth": ("genus", "cell", "gap"), "poisson": ("poisson_depth",)}


class SurfaceOptions(Options):
    """Filtered points with normals → closed surface."""

    mode: Literal["auto", "reconstruct", "keep"] = "auto"
    """Meshes to reconstruct. auto: those that are not closed and manifold; reconstruct: all; keep: none."""
    max_faces: Annotated[int, Field(ge=200)] = 200_000
    """Largest number of faces of a mesh that is used without reconstruction; a finer one is simplified to so
    many faces."""
    method: Literal["growth", "poisson"] = "growth"
    """The method of surface reconstruction. growth: topology-preserving region growing on a voxel grid, which
    gives a closed manifold surface of the genus below; poisson: screened Poisson reconstruction by Open3D."""
    genus: Literal["auto", "sphere", "free"] | Annotated[int, Field(ge=0)] = "auto"
    """Genus, the number of handles, of the surface by growth. sphere: 0; a number: that number; free:
    as many as the points suggest; auto: only handles about as thick as the body."""
    cell: Literal["auto"] | Annotated[float, Field(gt=0, lt=0.1)] = "auto"
    """Edge of the voxels of growth; relative to the diagonal. auto: .0033 to .0045, by the noise of the
    points. At least the spacing of the points."""
    gap: Length = 0.02
    """Radius of the largest hole in the scan that growth closes against the outside; relative to the
    diagonal."""
    # Largest distance over which growth connects a component that a hole has separated to the body; relative
    # to the diagonal.
    bridge: ClassVar[float] = 0.08
    reconstructions: Count = 2
    """Number of surfaces that growth reconstructs from one scan, with voxels of the edge above, 4/3 of it,
    3/4 of it, and so on in turn. The signature is the geometric mean over the surfaces, and its error bar is
    the standard deviation over them."""
    # The coarse surface by which growth fills holes has 2^fill_depth voxels on its longest side; for a scan
    # with large holes it is a Poisson surface with an octree of this depth.
    fill_depth: ClassVar[int] = 6
    poisson_depth: Annotated[int, Field(ge=4, le=12)] = 7
    """Octree depth of the method poisson; its smallest cell is poisson_scale · longest side / 2^depth."""
    # Side of the cube of the method poisson; relative to the longest side of the bounding box.
    poisson_scale: ClassVar[float] = 1.1
    target_faces: Annotated[int, Field(ge=200)] = 10_000
    """Largest number of faces after simplification."""
    # Number of points sampled on a mesh with defects before it is reconstructed.
    sample_points: ClassVar[int] = 30_000
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
            if method != self.method
            and getattr(self, name) != type(self).model_fields[name].default
        )


class RemeshOptions(Options):
    """Closed surface → boundary of a tetrahedral mesh (fTetWild)."""

    method: Literal["none", "tetwild"] = "none"
    """The remesher. The surface method growth needs none, because its surface is a closed manifold."""
    edge_length: Annotated[float, Field(gt=0, lt=1)] = 0.05
    """Ideal edge length of the tetrahedra; relative to the diagonal."""
    # Largest distance of the new surface from the old one; relative to the diagonal.
    envelope: ClassVar[float] = 0.001
    timeout: Annotated[float, Field(gt=0)] = 60.0
    """Time limit; seconds. After it the surface is used as it was before remeshing."""
    # Largest relative change of area or volume. Beyond it the surface is used as it was before remeshing.
    max_change: ClassVar[float] = 0.1


class SpectralOptions(Options):
    """Surface of unit area → smallest eigenpairs of its Laplace–Beltrami operator."""

    element: Literal["linear", "cubic", "intrinsic-delaunay", "points"] = "linear"
    """Discretisation of the operator. linear, cubic: finite elements on the triangles of the surface;
    intrinsic-delaunay: linear elements on the intrinsic Delaunay triangulation of the tufted cover, robust to
    badly shaped and non-manifold triangles; points: linear elements on local triangulations of the filtered
    points, without a surface."""
    n_pairs: Annotated[int, Field(ge=3)] = 61
    """Number of eigenpairs that are computed and stored, including the constant eigenfunction."""

    @property
    def of_points(self) -> bool:
        """Whether the operator is that of the points, without a surface."""
        return self.element == "points"


Scale = Literal["relative", "area", "absolute"]
# A dictionary has as many atoms, of as many frequencies, as those of `pcretrieve.shrec.dl`.
Atom = Annotated[
    tuple[Annotated[float, Field(ge=-1, le=1)], ...], Field(min_length=19, max_length=19)
]
Atoms = Annotated[tuple[Atom, ...], Field(min_length=32, max_length=32)]


def fused_names(method: str) -> tuple[str, ...]:
    """The names of the descriptors that a method fuses, in order."""
    return tuple(method.split("+"))


def _known_method(method: str) -> str:
    for name in fused_names(method):
        DESCRIPTOR_NAMES.known(name)
    return method


class SignatureOptions(Options):
    """Spectrum and surface → descriptor."""

    method: Annotated[str, AfterValidator(_known_method)] = "hapt+r-bihdm"
    """The descriptor, as listed by `lab signature --help-all`. Names joined by + fuse descriptors."""
    n_values: Annotated[int, Field(ge=1, le=10_000)] = 23
    """Number L of values of the descriptor, or of each that is fused; of bags of features, of words.
    Higher values depend more on how finely a surface is triangulated."""
    n_modes: Annotated[int, Field(ge=2)] = 60
    """Number m of modes at which R-BiHDM, BiHDM, and the heat and wave kernels are truncated."""
    scale: Scale = "area"
    """Normalisation of the values. area: by the area of the surface; relative: by the first value of the
    descriptor, as in the papers; absolute: none. area and relative are invariant to scaling; absolute
    compares sizes too, for files in one unit or whose units are all known. By area, rankings are better."""
    size_weight: Annotated[float, Field(ge=0, le=20)] = 0.0
    """Weight w of the size of a body relative to its form: area^w is appended to the values, if w > 0. In log
    distances, bodies whose areas differ by a factor of exp(1/w) are then 1 apart. For files in one unit or
    whose units are all known. Gives better rankings than the scale absolute; 6 is best for people."""
    atoms: Atoms | None = None
    """Atoms of dl-supervised that `lab calibrate` has learned; none for the shipped ones."""

    @property
    def of_other_packages(self) -> bool:
        """Whether a descriptor is one that another package adds."""
        return not METHODS.keys() >= {*fused_names(self.method)}

    @property
    def compares_sizes(self) -> bool:
        """Whether signatures depend on the size of bodies, and so on the unit of the files."""
        return self.scale == "absolute" or self.size_weight > 0

    @model_validator(mode="after")
    def _has_a_size(self) -> SignatureOptions:
        has_size = any(METHODS.get(name, True) for name in fused_names(self.method))
        if self.scale == "absolute" and not has_size:
            raise ValueError(
                f"scale: must be area or relative for {self.method}, which has no size to keep; absolute is "
                "for " + ", ".join(name for name, is_sized in METHODS.items() if is_sized)
            )
        return self


WhiteningKind = Literal[
    "auto", "unsupervised", "none", "people", "neighbours", "pca", "within-class"
]
RerankKind = Literal["none", "k-reciprocal"]
Shrinkage = Literal["auto"] | Annotated[float, Field(gt=0, le=1)]


class RetrievalOptions(Options):
    """Signatures → ranked shapes. No stored spectrum or signature depends on these options."""

    distance: Literal["log", "d1", "d2"] = "log"
    """Distance of two signatures. log: the Euclidean distance of their logarithms; d1, d2: the
    dissimilarities D1 and D2 of Ye and Yu."""
    whitening: WhiteningKind = "auto"
    """Differences of log-signatures that count less, by a linear map. people: those between scans of one
    person, learned from simulated people, for hapt, r-bihdm and both; neighbours: those between shapes that
    are among each other's nearest; within-class: those within classes; pca: those between all shapes; none:
    no map. auto: people if most shapes are like people; else within-class if labels suffice, else neighbours;
    none for few shapes. unsupervised: auto without labels, as in an evaluation."""
    calibration: str | None = None
    """File that `lab calibrate` has written, in place of the option whitening; none by default."""
    shrinkage: Shrinkage = "auto"
    """Regularisation of a covariance: for pca relative to its largest eigenvalue, for others the shrinkage
    intensity. auto: .01, and .2 for neighbours; for within-class the likeliest on classes left out."""
    rerank: RerankKind = "none"
    """k-reciprocal: sort the first hundred results again by the neighbours that two shapes share (the overlap
    of their k-reciprocal neighbourhoods), but keep the first."""
    # Number of folds of classes with which a within-class whitening is evaluated.
    n_folds: ClassVar[int] = 5
    # Seed of the random assignment of classes to folds.
    fold_seed: ClassVar[int] = 0

    @property
    def without_labels(self) -> RetrievalOptions:
        """The options, in which the whitening auto is not fitted to labels, as in an evaluation."""
        return (
            self.model_copy(update={"whitening": "unsupervised"})
            if self.whitening == "auto"
            else self
        )


Kept = Literal["meshes", "overlaps"]


def _in_order(keep: tuple[Kept, ...]) -> tuple[Kept, ...]:
    """Each part once, so that two lists of the same parts are equal."""
    return tuple(part for part in get_args(Kept) if part in keep)


class CatalogueOptions(Options):
    """What is stored of a shape beside its spectra. No value of a signature depends on these options."""

    keep: Annotated[tuple[Kept, ...], AfterValidator(_in_order)] = ("meshes",)
    """Parts of each surface that are stored beside the 28 kB of its spectrum and a thumbnail of 5 kB. meshes:
    vertices and faces, 149 kB for 10,000 faces, for views in 3-D, exports and other descriptors. overlaps:
    the integrals of products of squared eigenfunctions, 25 kB, for the descriptors wks and bihdm; they are
    computed from the mesh where they are not stored."""


class MergeOptions(Options):
    """Range scans (views), with or without poses → one cloud in one frame, before the pipeline.

    Lengths called relative are relative to the median bounding-box diagonal of the views without background.
    """

    refine: bool = True
    """Refine given poses by registration, or use them as they are."""
    sensor: Literal["front", "origin"] = "front"
    """Position of the sensor of a view whose file has none. front: far along the z axis, as of range
    scanners; origin: at the origin, as of depth cameras."""
    background: Literal["none", "planes", "room"] = "none"
    """What is removed. planes: floors and walls, which have a tenth of the points and nothing behind them;
    room: also all behind the first valley in the histogram of depths, or beyond max_range."""
    keep_largest: bool = False
    """Remove all but the largest connected component of each view."""
    # Distance between points above which they are in different components; relative to the diagonal of the
    # view.
    piece_gap: ClassVar[float] = 0.02
    voxel: Length = 0.0
    """Edge of the voxels in which the points of the merged cloud are averaged, 0 to keep all points;
    relative."""
    # Number of neighbours to which the tangent plane of a point is fitted.
    normal_neighbors: ClassVar[int] = 16
    # Edge of the voxels of which each gives one point to the matching of features; relative.
    cell: ClassVar[float] = 0.012
    # Number of random samples of point correspondences for each pair of views.
    n_tries: ClassVar[int] = 200_000
    # Number of distinct rigid motions for each pair of views that are refined and verified.
    n_candidates: ClassVar[int] = 12
    reach: Annotated[float, Field(gt=0, lt=0.1)] = 0.01
    """Largest distance between corresponding points of two registered views; relative."""
    min_overlap: Share = 0.1
    """Smallest overlap of a view with the other views; fraction of its points."""
    # Largest number of points of a view that lie in space which another view observed as empty; relative to
    # the number of points in the overlap.
    max_contradiction: ClassVar[float] = 0.02
    # Seed of the random samples.
    seed: ClassVar[int] = 0
