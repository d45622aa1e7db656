"""The options of the stages from points with normals to the final surface."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, Field

from pcretrieve.names import NAMES
from pcretrieve.options.model import Count, Length, Options, Share

__all__ = ["RemeshOptions", "SurfaceOptions"]

# The options that one method of surface reconstruction alone uses. `reconstructions` is not here: that the
# method poisson makes one surface is noted for the default too.
ONLY_OF_METHOD = {
    "growth": ("genus", "cell", "gap"),
    "poisson": ("poisson_depth",),
}


class SurfaceOptions(Options):
    """Filtered points with normals → closed surface."""

    mode: Literal["auto", "reconstruct", "keep"] = "auto"
    """What is done if the input is a mesh. auto: reconstruct it unless it is closed and manifold;
    reconstruct: always; keep: never."""
    max_faces: Annotated[int, Field(ge=200)] = 200_000
    """Largest number of faces of a mesh that is used without reconstruction; a finer one is simplified to so
    many faces."""
    method: Annotated[str, AfterValidator(NAMES["surface method"].known)] = "growth"
    """The method of surface reconstruction. growth: topology-preserving region growing on a voxel grid, which
    gives a closed manifold surface of the genus below; poisson: screened Poisson reconstruction by Open3D.
    Other packages can add methods."""
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
    # Fraction of the vertices, those with the lowest point density, that the method poisson removes before
    # remeshing.
    density_trim: ClassVar[float] = 0.0
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
            if method != self.method and getattr(self, name) != type(self).model_fields[name].default
        )


class RemeshOptions(Options):
    """Closed surface → boundary of a tetrahedral mesh (fTetWild)."""

    method: Literal["none", "tetwild"] = "none"
    """The remesher. The surface method growth needs none, because its surface is a closed manifold."""
    edge_length: Annotated[float, Field(gt=0, lt=1)] = 0.05
    """Ideal edge length of the tetrahedra; relative to the diagonal."""
    # Largest distance of the new surface from the old one; relative to the diagonal.
    envelope: ClassVar[float] = 0.001
    optimize: bool = False
    """Optimise the quality of the tetrahedra. Slow, without benefit for the signature of the surface."""
    timeout: Annotated[float, Field(gt=0)] = 60.0
    """Time limit; seconds. After it the surface is used as it was before remeshing."""
    # Largest relative change of area or volume. Beyond it the surface is used as it was before remeshing.
    max_change: ClassVar[float] = 0.1
