"""
A catalogue and a query
=======================

Six sample scans are ingested, and a seventh asks who it is.
"""

import tempfile
from pathlib import Path

from sample import SCANS, draw

import pcretrieve as pr

names = [
    "person-1_stand",
    "person-1_walk",
    "person-2_stand",
    "person-2_run",
    "hand-1_open",
    "animal-1_walk",
]
paths = [SCANS / name.split("_")[0] / f"{name}.ply" for name in names]
query = SCANS / "person-2" / "person-2_wave.ply"
with tempfile.TemporaryDirectory() as folder:
    catalogue = Path(folder) / "bodies.sqlite"
    pr.ingest(paths, catalogue, labels=SCANS / "labels.csv")
    found = pr.search(catalogue, query, k=4)
    with pr.Catalogue(catalogue) as shapes:
        bodies = {
            f"{name}\n{distance:.2f}": shapes.mesh(name)
            for name, distance in zip(
                found.neighbors.ids, found.neighbors.distances, strict=True
            )
        }
print(found)
draw({"query": pr.reconstruct(query)} | bodies)
