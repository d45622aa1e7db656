"""Shape → global shape descriptor, with one module for each method.

Each module declares a record `Descriptor` beside its function. `DESCRIPTORS` finds the records of this room,
of `pcretrieve.shrec` and of other packages by name, and `describe` applies the one that the options name.
"""

from pcretrieve.descriptors.bihdm import bihdm, full_matrix
from pcretrieve.descriptors.csd import csd, wks
from pcretrieve.descriptors.describe import DESCRIPTORS, describe, signature_length
from pcretrieve.descriptors.descriptor import Descriptor
from pcretrieve.descriptors.hapt import hapt
from pcretrieve.descriptors.r_bihdm import r_bihdm, reduced_matrix
from pcretrieve.descriptors.shape_dna import shape_dna

__all__ = [
    "DESCRIPTORS",
    "Descriptor",
    "bihdm",
    "csd",
    "describe",
    "full_matrix",
    "hapt",
    "r_bihdm",
    "reduced_matrix",
    "shape_dna",
    "signature_length",
    "wks",
]
