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
    """One catalogue and everything that is kept of it between requests."""

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
