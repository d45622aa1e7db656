"""A package that adds one of every kind to pcretrieve."""

import numpy as np
from scipy.sparse import csc_array

from pcretrieve.descriptors import Descriptor
from pcretrieve.options import SignatureOptions
from pcretrieve.retrieval import Distance
from pcretrieve.spectral import ELEMENTS, Assembled, Element
from pcretrieve.types import FloatArray, Shape, Signature, TriangleMesh


def girth(shape: Shape, options: SignatureOptions) -> Signature:
    """Quantiles of the distance of the vertices from their mean; unit length of the file."""
    reach = np.linalg.norm(shape.mesh.vertices - shape.mesh.vertices.mean(axis=0), axis=1)
    return Signature(np.quantile(reach, np.linspace(0.1, 0.9, options.n_values)), kind="girth")


def soft(mesh: TriangleMesh) -> Assembled:
    """Linear elements of a material of half the stiffness."""
    linear = ELEMENTS["linear"].assemble(mesh)
    return linear._replace(stiffness=csc_array(linear.stiffness / 2))


def largest(x: FloatArray) -> FloatArray:
    """The largest difference of two coordinates, L∞."""
    return np.asarray(np.abs(x).max(axis=-1))


GIRTH = Descriptor("girth", girth, needs=("mesh",))
SOFT = Element("soft", soft)
LARGEST = Distance("largest", largest, metrics=("logarithms", "values"))
