"""A reader, a writer and a remover of one catalogue at once, each a process of its own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import shapes

from pcretrieve import Catalogue, PipelineOptions
from pcretrieve.catalogue import Content, Record
from pcretrieve.descriptors import describe
from pcretrieve.pipeline.process import process
from pcretrieve.values import FloatArray

PATIENCE = 120  # seconds
N_SHAPES = 41  # the last one is not removed
OPTIONS = PipelineOptions()

# Stores shapes whose values are those of the first shape times their number.
WRITER = """
import sys
from dataclasses import replace
from pcretrieve import Catalogue
from pcretrieve.catalogue import Content

with Catalogue(sys.argv[1]) as store:
    first, values = store.record("s000"), store.signatures().values[0]
    shape = store.shape("s000")
    for number in range(1, int(sys.argv[2])):
        name = f"s{number:03}"
        record = replace(first, id=name, path=f"/{name}.off", content_hash=name)
        store.put(record, Content(shape, values * (1 + number)))
"""

# Removes every third shape as soon as it is there.
REMOVER = """
import sys
from pcretrieve import Catalogue

with Catalogue(sys.argv[1]) as store:
    left = {f"s{number:03}" for number in range(1, int(sys.argv[2])) if number % 3 == 0}
    while left:
        found = left.intersection(record.id for record in store.records())
        store.remove(*found)
        left -= found
"""

# Sees whole shapes only, until the last one is there.
READER = """
import sys
import numpy as np
from pcretrieve import Catalogue

with Catalogue(sys.argv[1]) as store:
    values = store.signatures().values[0]
    last = ""
    while last != f"s{int(sys.argv[2]) - 1:03}":
        table = store.signatures()
        last = table.ids[-1]
        numbers = np.array([int(name[1:]) for name in table.ids])
        assert (table.values == np.outer(1 + numbers, values)).all()
        assert all(record.status == "done" for record in store.records())
        assert store.index().nearest("s000", 1).ids == ("s000",)
"""


def put_first(location: str) -> FloatArray:
    """A catalogue of one shape; its values."""
    shape = process(shapes.icosphere(3), OPTIONS)
    values = describe(shape, OPTIONS.signature).values
    with Catalogue(location, OPTIONS, create=True) as store:
        store.put(Record("s000", "/s000.off", "s000"), Content(shape, values))
    return values


@pytest.mark.slow
def test_reader_writer_and_remover_at_once(
    new_location: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    values = put_first(new_location)
    running = [
        subprocess.Popen(
            [sys.executable, "-c", code, new_location, str(N_SHAPES)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for code in (READER, REMOVER, WRITER)
    ]
    said = [process.communicate(timeout=PATIENCE) for process in running]
    assert [process.returncode for process in running] == [0, 0, 0], said
    left = [number for number in range(N_SHAPES) if number == 0 or number % 3]
    with Catalogue(new_location) as store:
        table = store.signatures()
        assert table.ids == tuple(f"s{number:03}" for number in left)
        assert (table.values == np.outer(1 + np.array(left), values)).all()
        assert [record.id for record in store.records()] == list(table.ids)
        mesh = store.mesh("s000")
        assert all(store.mesh(shape_id) == mesh for shape_id in table.ids)
