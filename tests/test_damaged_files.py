"""A damaged file gives what it held, or an error that names the file."""

from __future__ import annotations

import io
import os
import shutil
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import shapes
from benchmarks.damage import CHANGES, DAMAGES, damaged, read_damaged
from PIL import Image
from pypcd4.pypcd4 import Encoding, PointCloud as Pcd
from scan_files import (
    CAN_WRITE,
    POSE,
    XYZ,
    collada,
    ply,
    three_mf,
    with_checksums,
    without_checksums,
    write_e57,
    write_gltf,
    write_las,
)

from pcretrieve import (
    Catalogue,
    PipelineOptions,
    PointCloud,
    TriangleMesh,
    calibrate,
    ingest,
    status,
)
from pcretrieve.evaluation import evaluate
from pcretrieve.evaluation.comparison import read_scores
from pcretrieve.formats import read_scan, write_cloud, write_mesh
from pcretrieve.formats.registry import FORMATS, missing_extra
from pcretrieve.gallery import fitted
from pcretrieve.gallery.fitted import index, signatures
from pcretrieve.ingestion.discover import discover
from pcretrieve.ingestion.labels import read_labels
from pcretrieve.retrieval import DistanceMatrix, read_matrix, write_matrix
from pcretrieve.retrieval.whitening import read_whitening

# Seeds of each format of scans, and of each other kind of file.
N_SCAN_SEEDS, N_SEEDS = (
    int(os.environ.get("PCRETRIEVE_SEEDS", default)) for default in ("60", "165")
)

# --- scans --------------------------------------------------------------------------------------------------

BALL = shapes.icosphere(1)
NORMALS = BALL.vertices / np.linalg.norm(BALL.vertices, axis=1, keepdims=True)
CLOUD = PointCloud(BALL.vertices, NORMALS, 3 * NORMALS)
ELEMENTS = (
    f"element vertex 42\n{XYZ}element face 3\nproperty list uchar int vertex_indices\n"
)
POLYGONS = [[3, 0, 1, 2], [4, 2, 3, 4, 5], [3, 6, 7, 8]]
BIG_ENDIAN = [
    bytes([n]) + np.array(polygon, dtype=">i4").tobytes() for n, *polygon in POLYGONS
]
GRID = np.array([[x, y, 9 - (x * x + y * y) / 20, x] for x in range(6) for y in range(7)])
DEPTH = Image.fromarray(
    np.fromfunction(lambda v, u: 1500 + u * u + v, (30, 40)).astype(np.uint16)
)


def lines(rows: Any) -> str:
    return "".join(" ".join(f"{value:.6g}" for value in row) + "\n" for row in rows)


# A whole file of each format in each of its encodings: its content, or what writes it.
SCANS: dict[str, str | bytes | Callable[[Path], object]] = {
    **dict.fromkeys(
        ("mesh.ply", "mesh.obj", "mesh.off", "mesh.stl", "mesh.glb"),
        partial(write_mesh, BALL),
    ),
    **dict.fromkeys(
        ("cloud.ply", "cloud.pcd", "cloud.xyzn"), partial(write_cloud, CLOUD)
    ),
    "text.ply": ply("ascii", ELEMENTS, (lines(BALL.vertices) + lines(POLYGONS)).encode()),
    "big_endian.ply": ply(
        "binary_big_endian", ELEMENTS, BALL.vertices.astype(">f4").tobytes(), *BIG_ENDIAN
    ),
    "text.stl": shapes.icosphere(0).to_trimesh().export(file_type="stl_ascii"),
    **{
        f"{encoding.value}.pcd": partial(
            Pcd.from_xyz_points(BALL.vertices.astype(np.float32)).save, encoding=encoding
        )
        for encoding in (Encoding.ASCII, Encoding.BINARY_COMPRESSED)
    },
    "lines.xyz": lines(BALL.vertices),
    "lines.pts": "42\n" + lines(BALL.vertices),
    "lines.xyzrgb": lines(np.tile(BALL.vertices, 2)),
    "lines.asc": "// X Y Z\n" + lines(BALL.vertices),
    "lines.csv": "x,y,z\n" + lines(BALL.vertices).replace(" ", ","),
    "lines.txt": lines(np.column_stack([BALL.vertices, NORMALS])),
    "missing.txt": lines(BALL.vertices) + "1.#QNAN -nan(ind) 3 # none\n" * 3,
    "strips.ply": ply(
        "ascii",
        f"element vertex 42\n{XYZ}element tristrips 1\nproperty list int int vertex_indices\n",
        (lines(BALL.vertices) + "9 0 1 3 -1 2 4 6 5 7\n").encode(),
    ),
    "wrapped.obj": "".join(f"v {x:g} \\\n{y:g} {z:g}\n" for x, y, z in BALL.vertices)
    + "".join(f"f {a + 1}//1 \\\n {b + 1} {c + 1}\n" for a, b, c in BALL.faces[:9]),
    "colours.off": "COFF42 9 0\n"
    + "".join(f"{x:g} {y:g} {z:g} 1 2 3\n" for x, y, z in BALL.vertices)
    + "".join(f"3 {a} {b} {c} .5\n" for a, b, c in BALL.faces[:9]),
    "grids.ptx": 2 * (f"6\n7\n{POSE}" + lines(GRID)),
    "scene.gltf": lambda path: write_gltf(path, BALL, [{"mesh": 0}], "scene.bin"),
    "data.gltf": lambda path: write_gltf(path, BALL, [{"mesh": 0}]),
    "scene.3mf": three_mf(BALL),
    "scene.dae": lambda path: path.write_text(collada(BALL)),
    "scan.las": lambda path: write_las(path, BALL.vertices),
    "scan.laz": lambda path: write_las(path, BALL.vertices, point_format=6),
    "scan.e57": lambda path: write_e57(
        path, [{"points": BALL.vertices, "translation": np.arange(3.0)}]
    ),
    **dict.fromkeys(("depth.png", "depth.tif", "depth.tiff"), DEPTH.save),
    "depth.npy": lambda path: np.save(path, np.asarray(DEPTH)),
    "array.npy": lambda path: np.save(path, BALL.vertices),
    "arrays.npz": lambda path: np.savez_compressed(
        path, points=BALL.vertices, normals=NORMALS
    ),
    "views.conf": "camera 0 0 0\nbmesh a.ply 0 0 0 0 0 0 1\nbmesh a.pcd 0 0 1 0 0.6 0 0.8\n",
}


def whole_scan(name: str, folder: Path) -> Path:
    """A file, beside the files to which others refer."""
    path = folder / name
    if missing_extra(path.suffix) or not CAN_WRITE.get(path.suffix, True):
        pytest.skip(f"needs what reads and writes {path.suffix} files")
    for part in ("a.ply", "a.pcd"):
        write_cloud(CLOUD, folder / part)
    (folder / "camera.toml").write_text("fx = 60\nfy = 60\ncx = 20\ncy = 15\n")
    scan = SCANS[name]
    if callable(scan):
        scan(path)
    else:
        path.write_bytes(scan if isinstance(scan, bytes) else scan.encode())
    return path


def damaged_scan(whole: bytes, suffix: str, seed: int) -> bytes:
    """A damaged file; every second one is damaged below its compression and its checksums.

    Those find most damage of a file, so that what reads its content would see little of it.
    """
    if suffix == ".e57":
        return with_checksums(damaged(without_checksums(whole), seed), len(whole))
    if seed % 2 and suffix in (".3mf", ".npz"):
        return damaged_member(whole, seed)
    if seed % 2 and suffix == ".png":
        return with_chunks(damaged(whole, seed))
    return damaged(whole, seed)


def damaged_member(archive: bytes, seed: int) -> bytes:
    """An archive in which one file is damaged."""
    file = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(archive)) as old, zipfile.ZipFile(file, "w") as new:
        names = old.namelist()
        chosen = names[seed // 2 % len(names)]
        for name in names:
            content = old.read(name)
            new.writestr(name, damaged(content, seed) if name == chosen else content)
    return file.getvalue()


def with_chunks(data: bytes) -> bytes:
    """A PNG file with the checksum of each chunk, as far as the lengths of the chunks are right."""
    at, content = 8, bytearray(data)
    while at + 12 <= len(content):
        (length,) = struct.unpack_from(">I", content, at)
        end = at + 8 + length
        if end + 4 > len(content):
            break
        struct.pack_into(">I", content, end, zlib.crc32(content[at + 4 : end]))
        at = end + 4
    return bytes(content)


def test_every_format_is_damaged() -> None:
    assert {Path(name).suffix for name in SCANS} == FORMATS.own.keys()


@pytest.mark.parametrize("name", SCANS)
def test_a_name_that_is_not_utf8_is_read_as_any_other(name: str, tmp_path: Path) -> None:
    path = whole_scan(name, tmp_path)
    scan = read_scan(path)
    other = read_scan(
        path.rename(path.with_name(os.fsdecode(b"latin-\xe9") + path.suffix))
    )
    if isinstance(scan, TriangleMesh) and isinstance(other, TriangleMesh):
        scan, other = PointCloud(scan.vertices), PointCloud(other.vertices)
    assert scan == other


@pytest.mark.slow
@pytest.mark.parametrize("name", SCANS)
def test_a_damaged_scan_is_read_or_named(name: str, tmp_path: Path) -> None:
    whole = whole_scan(name, tmp_path).read_bytes()
    path = tmp_path / f"damaged{Path(name).suffix}"
    content = partial(damaged_scan, whole, path.suffix)
    n_errors, faults = read_damaged(path, content, read_scan, N_SCAN_SEEDS, str(path))
    assert not faults
    assert n_errors


# --- other files --------------------------------------------------------------------------------------------

# Files that were read wrongly once: a folder for each kind of file.
FOUND = sorted((Path(__file__).parent / "corpus").glob("*/*"))


def read_catalogue(path: Path) -> object:
    """Everything that a catalogue holds."""
    for log in ("-wal", "-shm"):
        path.with_name(path.name + log).unlink(missing_ok=True)
    with Catalogue(path) as store:
        records = store.records()
        done = [record.id for record in records if record.status == "done"]
        meshes = [store.mesh(shape_id) for shape_id in done]
        whole = [store.shape(shape_id, ("spectrum", "overlaps")) for shape_id in done]
        return (
            records,
            signatures(store),
            store.rows.areas(),
            meshes,
            whole,
            status(store),
        )


def read_index(path: Path) -> object:
    """The nearest neighbours by a stored index, one of whose arrays is damaged."""
    with Catalogue(path.with_name("indexed.sqlite")) as store:
        assert store.cache.folder is not None
        (folder,) = store.cache.folder.iterdir()
        path.replace(folder / path.name.partition("-")[2])
        nearest = index(store).nearest("egg0", k=3).ids
    assert nearest == ("egg0", "egg1", "egg2")
    return nearest


def distances_in(path: Path) -> object:
    shutil.copy(path.with_name("matrix.ids"), path.with_suffix(".ids"))
    return read_matrix(path)


def scans_in(path: Path) -> object:
    return discover([path])


# Lists, labels and options of the scans in the folder `whole`.
TEXTS = {
    "options.toml": "[surface]\nmode = 'keep'\ncell = 0.01\n[signature]\nn_values = 9\n",
    "labels.csv": "file,class\n" + "".join(f"egg{k},class{k // 2}\n" for k in range(6)),
    "labels.cla": "PSB 1\n2 3\n\ncat 0 2\n5\n6\n\ndog 0 1\n7\n",
    "scans.txt": "".join(f"scans/egg{k}.off\n" for k in range(6)),
    "scans.csv": "path,x\n" + "".join(f"scans/egg{k}.off,\n" for k in range(6)),
}


class Kind(NamedTuple):
    """The name of a file, how it is read, and its damages."""

    file: str
    read: Callable[[Path], object]
    damages: Sequence[str] = DAMAGES


KINDS = {
    "catalogue": Kind("c.sqlite", read_catalogue),
    "pages of a catalogue": Kind("c.sqlite", read_catalogue, CHANGES),
    "index, numbers": Kind("gallery.npy", read_index),
    "index, ids": Kind("ids.npy", read_index),
    "whitening": Kind("metric.npz", read_whitening),
    "options": Kind("options.toml", PipelineOptions.from_toml),
    "labels": Kind("labels.csv", read_labels),
    "labels of Princeton": Kind("labels.cla", read_labels),
    "list of scans": Kind("scans.txt", scans_in),
    "table of scans": Kind("scans.csv", scans_in),
    "matrix": Kind("matrix.txt", distances_in),
    "binary matrix": Kind("matrix.npy", distances_in),
    "measures": Kind("queries.csv", read_scores),
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with a whole file of each kind."""
    folder = tmp_path_factory.mktemp("whole")
    scans = folder / "scans"
    scans.mkdir()
    for number in range(6):
        egg = shapes.ellipsoid((1, 1 + number / 10, 1.5), subdivisions=2)
        write_mesh(egg, scans / f"egg{number}.off")
    (scans / "flat.xyz").write_text("1 2 3\n" * 200)
    labels = {f"egg{number}": f"class{number // 2}" for number in range(6)}
    for name, text in TEXTS.items():
        (folder / name).write_text(text)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fitted, "SMALLEST_KEPT", 1)
        for name in ("c.sqlite", "indexed.sqlite"):
            with Catalogue(folder / name, create=True) as store:
                ingest(scans, store, labels=labels)
                if name == "indexed.sqlite":
                    index(store)
                    assert store.cache.folder is not None
                    arrays = sorted(store.cache.folder.glob("*/*.npy"))
                else:
                    options = store.options.changed(retrieval={"whitening": "none"})
                    evaluate(store, options=options).write(folder)
                    table = signatures(store, options=options)
                    calibrate(store, folder / "metric.npz", options=store.options)
        distances = np.abs(table.values[:, :1] - table.values[:, 0])
        for suffix in ("txt", "npy"):
            write_matrix(
                DistanceMatrix(table.ids, distances), folder / f"matrix.{suffix}"
            )
        for array in arrays:
            shutil.copy(array, folder)
        yield folder


def test_a_whole_file_of_every_kind_is_read(whole: Path) -> None:
    for kind in KINDS.values():
        kind.read(Path(shutil.copy(whole / kind.file, whole / f"copy-{kind.file}")))


def faults(
    name: str, whole: Path, content: Callable[[bytes, int], bytes], n_seeds: int = 1
) -> list[str]:
    """The faults of reading such a file with so many damages."""
    kind = KINDS[name]
    data, path = (whole / kind.file).read_bytes(), whole / f"damaged-{kind.file}"
    return read_damaged(
        path, lambda seed: content(data, seed), kind.read, n_seeds, path.stem
    )[1]


@pytest.mark.parametrize("name", KINDS)
def test_a_damaged_file_is_read_or_named(name: str, whole: Path) -> None:
    # A damaged index is computed and written again, which takes a tenth of a second.
    n_seeds = N_SEEDS // 10 if name.startswith("index") else N_SEEDS
    assert not faults(name, whole, partial(damaged, damages=KINDS[name].damages), n_seeds)


@pytest.mark.parametrize("found", FOUND, ids=lambda path: path.stem)
def test_a_file_that_was_read_wrongly_is_read_or_named(
    found: Path, whole: Path, tmp_path: Path
) -> None:
    if found.parent.name == "scan":
        # Beside the file of a camera.
        path = whole_scan("depth.npy", tmp_path).with_name(found.name)
        assert not read_damaged(
            path, lambda seed: found.read_bytes(), read_scan, 1, str(path)
        )[1]
    else:
        assert not faults(found.parent.name, whole, lambda data, seed: found.read_bytes())
