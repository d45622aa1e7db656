"""Shapes with provenance, spectra, surfaces and signatures, in an SQLite file or a PostgreSQL database.

In come records and processed shapes; out come records, shapes, tables of signatures, whitenings and indexes.
"""

from pcretrieve.catalogue.catalogue import Catalogue, CatalogueLike, thumbnails
from pcretrieve.catalogue.check import Defect, find_defects
from pcretrieve.catalogue.copies import backup, merge_catalogues
from pcretrieve.catalogue.records import Content, Record, numbered_id

__all__ = [
    "Catalogue",
    "CatalogueLike",
    "Content",
    "Defect",
    "Record",
    "backup",
    "find_defects",
    "merge_catalogues",
    "numbered_id",
    "thumbnails",
]
