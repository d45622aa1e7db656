"""The durable store: one row a shape, with provenance, spectrum, signature and status."""

from pcretrieve.catalogue.record import Content, Record, numbered_id
from pcretrieve.catalogue.store import Catalogue

__all__ = ["Catalogue", "Content", "Record", "numbered_id"]
