"""Scan files, written by hand: as they are meant to be, and as they should not."""

from __future__ import annotations

XYZ = "property float x\nproperty float y\nproperty float z\n"
PCD = (
    "VERSION 0.7\nFIELDS {fields}\nSIZE {sizes}\nTYPE {types}\nCOUNT {counts}\nWIDTH {n}\nHEIGHT 1\n"
    "VIEWPOINT {viewpoint}\nPOINTS {n}\nDATA {data}\n"
)


def pcd_header(*fields: str, n: int, data: str = "ascii", viewpoint: str = "0 0 0 1 0 0 0") -> str:
    repeat = {"sizes": "4", "types": "F", "counts": "1"}
    columns = {key: " ".join([value] * len(fields)) for key, value in repeat.items()}
    return PCD.format(fields=" ".join(fields), n=n, data=data, viewpoint=viewpoint, **columns)
