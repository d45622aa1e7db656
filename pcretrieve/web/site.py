"""What a server answers with: the readers of a catalogue, its title, and how shapes are compared."""

from __future__ import annotations

from dataclasses import dataclass, field

from pcretrieve.options import PipelineOptions
from pcretrieve.pages.thumbnails import Thumbnails
from pcretrieve.web.jobs import Jobs
from pcretrieve.web.maps import Maps
from pcretrieve.web.readers import Readers

__all__ = ["Site"]


@dataclass(frozen=True, slots=True, eq=False)
class Site:
    """One catalogue and everything that is kept of it between requests.

    Attributes
    ----------
    searching, drawing : Readers
        The threads that read the catalogue: for searches, and for all that takes longer.
    title : str
        Name of the collection.
    options : PipelineOptions
        How shapes are compared.
    jobs : Jobs or None
        The uploaded scans; None if scans cannot be uploaded.
    most_bytes : int
        Largest size of an uploaded scan.
    thumbnails : Thumbnails
        The thumbnails that were drawn.
    maps : Maps
        The map of the collection.
    up : {"x", "-x", "y", "-y", "z", "-z"} or None
        The axis of the files that points upwards; None if it is found from the shapes.
    """

    searching: Readers
    drawing: Readers
    title: str
    options: PipelineOptions
    jobs: Jobs | None
    most_bytes: int
    up: str | None = None
    thumbnails: Thumbnails = field(init=False)
    maps: Maps = field(default_factory=Maps)

    def __post_init__(self) -> None:
        object.__setattr__(self, "thumbnails", Thumbnails(self.up))
