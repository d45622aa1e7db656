"""The filters of points, of pcretrieve and of other packages, by name."""

from __future__ import annotations

from pcretrieve.names import NAMES
from pcretrieve.options import PointFilter
from pcretrieve.plugins import Registry, named
from pcretrieve.points.clean import CLEAN
from pcretrieve.points.crop import CROP
from pcretrieve.points.normals import ORIENT

POINT_FILTERS: Registry[PointFilter] = Registry(
    NAMES["point filter"], {record.name: record for record in (CROP, CLEAN, ORIENT)}, named(PointFilter)
)
