"""Shape → global shape descriptor, with one module for each method.

Each module declares a record `Descriptor` beside its function. `DESCRIPTORS` holds the records of pcretrieve
and of other packages by name, and `describe` applies the one that the options name.
"""

from pcretrieve.descriptors.bags import hks_bow
from pcretrieve.descriptors.bihdm import bihdm, bihdm_sampled, full_matrix, sd_gdm
from pcretrieve.descriptors.csd import csd, wks
from pcretrieve.descriptors.describe import DESCRIPTORS, describe, signature_length
from pcretrieve.descriptors.descriptor import Descriptor
from pcretrieve.descriptors.dl import dl
from pcretrieve.descriptors.hapt import hapt
from pcretrieve.descriptors.ispm import ispm
from pcretrieve.descriptors.r_bihdm import r_bihdm, reduced_matrix
from pcretrieve.descriptors.shape_dna import shape_dna, shape_dna_values

__all__ = [
    "DESCRIPTORS",
    "Descriptor",
    "bihdm",
    "bihdm_sampled",
    "csd",
    "describe",
    "dl",
    "full_matrix",
    "hapt",
    "hks_bow",
    "ispm",
    "r_bihdm",
    "reduced_matrix",
    "sd_gdm",
    "shape_dna",
    "shape_dna_values",
    "signature_length",
    "wks",
]
