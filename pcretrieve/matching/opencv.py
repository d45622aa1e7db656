"""The scale-invariant feature transform by OpenCV: pictures in, arrays of descriptors out.

OpenCV is installed by the extra ``views`` (``pip install pcretrieve[views]``).
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from pcretrieve.arrays import FloatArray
from pcretrieve.errors import OptionError

__all__ = ["SIFT_LENGTH", "sift_descriptors"]

#: Number of values of a descriptor: 4 × 4 cells of 8 directions.
SIFT_LENGTH = 128


def sift_descriptors(pictures: Iterable[FloatArray]) -> list[NDArray[np.uint8]]:
    """The SIFT descriptors of the keypoints of pictures [1]_, with OpenCV's default settings.

    pictures: iterable of (h, w) float64, grey values between 0 and 1.
    Returns list of (k, 128) uint8: the descriptors of each picture, dimensionless; k is 0 for a picture
        without keypoints.

    References
    ----------
    .. [1] D. Lowe, "Distinctive image features from scale-invariant keypoints", International Journal of
       Computer Vision 60 (2004).
    """
    try:
        import cv2
    except ImportError as error:
        raise OptionError(
            "SIFT needs OpenCV, which is not installed: pip install 'pcretrieve[views]'"
        ) from error
    cv2.setNumThreads(1)
    sift = cv2.SIFT.create()
    found = []
    for picture in pictures:
        _, descriptors = sift.detectAndCompute(np.round(255 * picture).astype(np.uint8), None)
        empty = np.zeros((0, SIFT_LENGTH), np.uint8)
        # OpenCV gives whole numbers from 0 to 255 in single precision.
        found.append(empty if descriptors is None else np.asarray(descriptors).astype(np.uint8))
    return found
