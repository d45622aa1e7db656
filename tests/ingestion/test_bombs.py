"""Small files that would fill the memory are refused before they do, or opened in processes with limits."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
import zipfile
import zlib
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from processes import MEASURE, MIB, peak_of
from scan_files import HALVES, POSE, SQUARE, glb, gltf, needs, write_e57

from pcretrieve import read_scan
from pcretrieve.catalogue.arrays import packed, stored_shape
from pcretrieve.catalogue.records import Payload
from pcretrieve.errors import InputError, ScanReadError
from pcretrieve.formats import ScanPath, members_of, parts_of
from pcretrieve.ingestion.discover import discover
from pcretrieve.retrieval.whitening import read_whitening

LIMITS: dict[str, Any] = {"workers": 1, "timeout": 60, "memory": None}


# --- files ------------------------------------------------------------------------------------------------

GLTF_BOMBS = {
    "objects": b'{"a": [' + b"{}," * 2_500_000 + b"{}]}",
    "numbers": b'{"a": [' + b"1.5," * 2_500_000 + b"1]}",
    "lists": b"[" * 2_500_000,
    "utf-16": ('{"a": [' + "{}," * 1_000_000 + "{}]}").encode("utf-16"),
}


@pytest.mark.parametrize("name", GLTF_BOMBS)
def test_json_of_many_values_is_not_parsed(tmp_path: Path, name: str) -> None:
    file = tmp_path / "a.gltf"
    file.write_bytes(GLTF_BOMBS[name])
    words = "must have at most 64 MiB and 250000 values, .* export the bodies alone"
    # The room for what is read, and no more.
    assert peak_of(lambda: parts_of(file), ScanReadError, words) < 80
    assert peak_of(lambda: read_scan(file), ScanReadError, words) < 20


def test_a_gltf_file_names_at_most_a_thousand_buffers(tmp_path: Path) -> None:
    file = tmp_path / "a.gltf"
    file.write_text(json.dumps({"buffers": [{"uri": f"{k}.bin"} for k in range(1001)]}))
    with pytest.raises(
        ScanReadError, match="must hold at most 1000 scans, views or arrays"
    ):
        parts_of(file)


@pytest.mark.slow
def test_discovery_opens_files_in_processes_with_limits(tmp_path: Path) -> None:
    (tmp_path / "gltf").mkdir()
    bomb = tmp_path / "gltf" / "a.gltf"
    bomb.write_bytes(12 * GLTF_BOMBS["objects"])
    tiff = tmp_path / "a.tif"
    tiff.write_bytes(many_tags(2000))
    (tmp_path / "camera.json").write_text(
        json.dumps({"fx": 1, "fy": 1, "cx": 1, "cy": 1})
    )
    for argument in (bomb, bomb.parent, tiff, tmp_path):
        done = subprocess.run(
            [sys.executable, "-c", MEASURE, argument],
            capture_output=True,
            text=True,
            check=True,
        )
        assert float(done.stdout) < 150, argument


def many_tags(n: int) -> bytes:
    """A TIFF image with n tags, each of which is a text of a megabyte: the same one."""
    size, start = MIB, 8 + 2 + 12 * n + 4
    tags = b"".join(struct.pack("<HHII", 40_000 + k, 2, size, start) for k in range(n))
    return b"II*\0" + struct.pack("<IH", 8, n) + tags + bytes(4) + b"a" * size


def test_a_file_that_takes_too_long_to_look_into_is_one_scan(tmp_path: Path) -> None:
    """Reading it as a scan, with the same limits, says why."""
    (tmp_path / "a.ptx").write_text(f"2\n2\n{POSE}0 0 0 0.5\n")
    found = discover([tmp_path], limits=LIMITS | {"timeout": 0})
    assert found == [ScanPath(tmp_path / "a.ptx")]


def test_every_format_holds_at_most_a_thousand_scans(tmp_path: Path) -> None:
    words = "a file must hold at most 1000 scans, views or arrays, this one has 100. or more: divide"
    (tmp_path / "a.ptx").write_text(f"1\n1\n{POSE}0 0 1 0.5\n" * 20_000)
    nodes = [{"mesh": 0} for _ in range(1001)]
    (tmp_path / "a.glb").write_bytes(glb(*gltf(SQUARE, HALVES, nodes, range(1001))))
    arrays: dict[str, Any] = {f"a{k}": np.ones(1) for k in range(1000)}
    np.savez(tmp_path / "a.npz", points=np.ones((9, 3)), **arrays)
    for name in ("a.ptx", "a.glb"):
        with pytest.raises(ScanReadError, match=words):
            members_of(tmp_path / name)
        assert discover([tmp_path / name]) == [ScanPath(tmp_path / name)]
    for name in ("a.glb", "a.npz"):
        with pytest.raises(ScanReadError, match=words):
            read_scan(tmp_path / name)


@needs(".e57")
@pytest.mark.slow
def test_an_e57_file_holds_at_most_a_thousand_scans(tmp_path: Path) -> None:
    write_e57(tmp_path / "a.e57", [{"points": np.ones((4, 3))} for _ in range(1001)])
    with pytest.raises(ScanReadError, match=r"at most 1000 scans.* has 1001"):
        members_of(tmp_path / "a.e57")


# --- archives ---------------------------------------------------------------------------------------------


def archive(path: Path, data: bytes, method: int, n: int = 1) -> None:
    with zipfile.ZipFile(path, "w", method) as made:
        for k in range(n):
            made.writestr(f"points{k or ''}.npy", data)


def array(n: int) -> bytes:
    head = f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({n}, 3), }}".encode()
    return (
        b"\x93NUMPY\x01\x00"
        + struct.pack("<H", 118)
        + head.ljust(117)
        + b"\n"
        + bytes(24 * n)
    )


def understated(path: Path) -> None:
    """Let the directory and the head of the only member declare a hundred bytes."""
    data = bytearray(path.read_bytes())
    for signature, place in ((b"PK\x03\x04", 22), (b"PK\x01\x02", 24)):
        struct.pack_into("<I", data, data.index(signature) + place, 100)
    path.write_bytes(data)


def bombs(folder: Path, suffix: str) -> Iterator[Path]:
    """Archives of some kilobytes that expand to 12 MB and more, each in a way of its own."""
    zeros = array(500_000)
    ways = {"one": (zipfile.ZIP_DEFLATED, 1), "bz2": (zipfile.ZIP_BZIP2, 1)}
    for name, (method, n) in ways.items():
        archive(folder / f"{name}{suffix}", zeros, method, n)
        yield folder / f"{name}{suffix}"
    archive(folder / f"many{suffix}", array(50_000), zipfile.ZIP_DEFLATED, 20)
    yield folder / f"many{suffix}"
    for name, (method, _) in ways.items():
        archive(folder / f"{name}-liar{suffix}", zeros, method)
        understated(folder / f"{name}-liar{suffix}")
        yield folder / f"{name}-liar{suffix}"
    # A megabyte of a directory that never ends.
    entry = b"PK\x01\x02" + bytes(24) + struct.pack("<H", 4) + bytes(16) + b"a.np"
    n = 3 * MIB // len(entry)
    end = struct.pack("<4s4H2IH", b"PK\5\6", 0, 0, 9999, 9999, n * len(entry), 0, 0)
    (folder / f"names{suffix}").write_bytes(n * entry + end)
    yield folder / f"names{suffix}"


def test_archives_that_expand_to_much_more(tmp_path: Path) -> None:
    for file in bombs(tmp_path, ".npz"):
        words = "members declare|directory declares|stored or deflated|Bad CRC"
        assert peak_of(partial(read_scan, file), ScanReadError, words) < 10, file


def test_a_whitening_that_expands_to_much_more(tmp_path: Path) -> None:
    for file in bombs(tmp_path, ".whitening"):
        words = "a whitening must be a name such as auto, or a file"
        assert peak_of(partial(read_whitening, file), InputError, words) < 10, file
    huge = tmp_path / "huge.npy"
    huge.write_bytes(array(0).replace(b"(0, 3)", b"(9999999999, 3)"))
    assert (
        peak_of(lambda: read_whitening(huge), InputError, "a whitening must be a name")
        < 5
    )


# --- catalogues -------------------------------------------------------------------------------------------


def checked(joined: bytes) -> bytes:
    return joined + struct.pack("<I", zlib.crc32(joined))


def test_arrays_of_a_catalogue_that_expand_to_much_more() -> None:
    """Many arrays, each of which may be; empty ones with long sides; and many surfaces."""
    spectra = packed([np.ones(1), np.ones((1, 4))])
    moments = packed([np.ones((1, 4, 4))])
    many = checked(200 * packed([np.zeros(2_000_000)])[:-4])
    sides = struct.pack("<2I", 0, 1), struct.pack("<2I", 0, 2**32 - 1)
    long = checked(packed([np.zeros((0, 1))])[:-4].replace(*sides))
    spread = packed([np.ones(1_000_000), np.ones((1_000_000, 1), np.int8)])
    bombs: tuple[tuple[dict[Payload, bytes], str], ...] = (
        ({"spectra": many}, "more than"),
        ({"spectra": spectra, "moments": many}, "more than 1 arrays"),
        ({"spectra": spectra, "meshes": many}, "more than"),
        ({"spectra": spread}, "surfaces, 1000 may be"),
        (
            {"spectra": spectra, "moments": moments, "overlaps": long},
            "declares more than",
        ),
        (
            {"spectra": spectra, "meshes": checked(9999 * packed([np.zeros(1)])[:-4])},
            "2 arrays",
        ),
    )
    for payloads, words in bombs:
        assert peak_of(partial(stored_shape, payloads, ()), ValueError, words) < 80, words
    whole: dict[Payload, bytes] = {"spectra": spectra, "moments": moments}
    whole["overlaps"] = packed([np.ones((1, 4, 4))])
    assert stored_shape(whole, ()).area == 1
