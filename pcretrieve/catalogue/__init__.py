"""Shapes with provenance, spectra, surfaces and signatures, in a store.

In come records and processed shapes; out come records, shapes, tables of signatures, whitenings and indexes.
A store has records and bytes, by default in an SQLite file.
"""

from pcretrieve.catalogue.defects import Defect
from pcretrieve.catalogue.merging import Merged
from pcretrieve.catalogue.opened import CatalogueLike, opened
from pcretrieve.catalogue.reading import stored_shapes
from pcretrieve.catalogue.record import Content, Record, free_id, numbered_id
from pcretrieve.catalogue.rows import Rows
from pcretrieve.catalogue.store import Catalogue
from pcretrieve.catalogue.stores import STORES, OpenStore

__all__ = [
    "STORES",
    "Catalogue",
    "CatalogueLike",
    "Content",
    "Defect",
    "Merged",
    "OpenStore",
    "Record",
    "Rows",
    "free_id",
    "numbered_id",
    "opened",
    "stored_shapes",
]
