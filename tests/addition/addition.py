"""A package that adds one of every kind to pcretrieve."""

import numpy as np

from pcretrieve.descriptors import Descriptor
from pcretrieve.options import SignatureOptions
from pcretrieve.types import Shape, Signature


def girth(shape: Shape, options: SignatureOptions) -> Signature:
    """Quantiles of the distance of the vertices from their mean; unit length of the file."""
    reach = np.linalg.norm(shape.mesh.vertices - shape.mesh.vertices.mean(axis=0), axis=1)
    return Signature(np.quantile(reach, np.linspace(0.1, 0.9, options.n_values)), kind="girth")


GIRTH = Descriptor("girth", girth, needs=("mesh",))
