"""What a server answers with: the readers of a catalogue, its title, and how shapes are compared."""

from __future__ import annotations

from dataclasses import dataclass, field

from pcretrieve.options import PipelineOptions
from pcretrieve.web.jobs import Jobs
from pcretrieve.web.maps import Maps
from pcretrieve.web.pictures import Thumbnails
from pcretrieve.web.readers import Readers

__all__ = ["Site"]


@dataclass(frozen=True, slots=True, eq=False)
class Site:
    """One catalogue and everything that is kept of it between requests.

    Attributes
    ----------
    readers : Readers
        The threads that read the catalogue.
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
    """

    readers: Readers
    title: str
    options: PipelineOptions
    jobs: Jobs | None
    most_bytes: int
    thumbnails: Thumbnails = field(default_factory=Thumbnails)
    maps: Maps = field(default_factory=Maps)
