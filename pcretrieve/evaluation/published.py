"""Published retrieval measures of other methods, by the layout of the set.

They are those of tables 3 and 5 of Ye and Yu, "A fast modal space transform for robust nonrigid shape
retrieval", The Visual Computer 2016, for the meshes as they are published. Table 5 cites Litman et al.,
"Supervised learning of bag-of-features shape descriptors using sparse coding", Computer Graphics Forum 2014.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple


class Published(NamedTuple):
    """The measures of one method."""

    method: str
    measures: tuple[float | None, ...]
    source: str


TABLE_3 = "Ye and Yu, table 3"
TABLE_5 = "Ye and Yu, table 5"

_SHREC11 = {
    "Shape-DNA": (0.998, 0.890, 0.952, 0.696, 0.975),
    "MDS-CM-BoF": (0.995, 0.913, 0.969, 0.717, 0.982),
    "meshSIFT": (0.998, 0.800, 0.851, 0.627, 0.944),
    "SD-GDM": (1.000, 0.956, 0.982, 0.728, 0.992),
    "BiHDM, L = 25": (0.990, 0.915, 0.979, 0.719, 0.984),
    "R-BiHDM, L = 23": (1.000, 0.971, 0.983, 0.730, 0.994),
}

# mAP of the synthetic and of the real track.
_SHREC14 = {
    "ISPM": (0.902, 0.258),
    "HAPT": (0.817, 0.637),
    "unsupervised dictionary learning": (0.842, 0.533),
    "supervised dictionary learning": (0.954, 0.791),
    "ShapeGoogle (VQ)": (0.813, 0.514),
    "R-BiHDM-s": (0.642, 0.640),
}


def _track(number: int) -> tuple[Published, ...]:
    return tuple(
        Published(method, (None,) * 5 + (values[number],), TABLE_5) for method, values in _SHREC14.items()
    )


#: The measures by the name of a layout, as in `pcretrieve.ingestion.labels.LAYOUTS`.
PUBLISHED: Mapping[str, tuple[Published, ...]] = MappingProxyType(
    {
        "shrec11": tuple(Published(method, (*values, None), TABLE_3) for method, values in _SHREC11.items()),
        "shrec14-synthetic": _track(0),
        "shrec14-real": _track(1),
    }
)
