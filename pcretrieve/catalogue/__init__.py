"""Shapes with provenance, spectra, surfaces and signatures, in an SQLite file or a PostgreSQL database.

In come records and processed shapes; out come the same records and shapes.
"""

from pcretrieve.catalogue.catalogue import Catalogue, CatalogueLike, mark, thumbnails
from pcretrieve.catalogue.copies import backup, merge_catalogues
from pcretrieve.catalogue.records import Content, Record, numbered_id

__all__ = [
    "Catalogue",
    "CatalogueLike",
    "Content",
    "Record",
    "backup",
    "mark",
    "merge_catalogues",
    "numbered_id",
    "thumbnails",
]
