"""The source distribution has all files of the project, and the wheel all files of the package."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from base64 import b64decode
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import pytest
from commands import program
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import pcretrieve

ROOT = Path(__file__).parents[1]

# Copyleft licences that apply to programs that are distributed with the library; the LGPL does not.
COPYLEFT = re.compile(r"\bA?GPL|GNU (Affero )?General Public", re.IGNORECASE)

# What a checkout alone has a use for: the gates of the repository, and the settings of version control.
ONLY_IN_A_CHECKOUT = (".ci/", ".github/", ".gitignore", ".pre-commit-config.yaml")


def tracked_files() -> list[str]:
    """The files under version control that are there, relative to the root."""
    if shutil.which("git") is None or not (ROOT / ".git").exists():
        pytest.skip(
            "not a git checkout: this compares a distribution with the files under version control"
        )
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True, text=True
    )
    return [
        name for name in listed.stdout.split("\0") if name and (ROOT / name).is_file()
    ]


def built(kind: str, source: Path, target: Path) -> Path:
    """The file that the build backend makes of the sources in a folder."""
    target.mkdir()
    code = (
        f"from setuptools.build_meta import build_{kind} as build; build({str(target)!r})"
    )
    subprocess.run([sys.executable, "-c", code], cwd=source, check=True)
    (made,) = target.iterdir()
    return made


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The source distribution, unpacked; made of the tracked files alone, as in a fresh clone."""
    base = tmp_path_factory.mktemp("distribution")
    for name in tracked_files():
        copy = base / "clone" / name
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, copy)
    with tarfile.open(built("sdist", base / "clone", base / "sdist")) as archive:
        # Newer versions of Python warn without an extraction filter; early releases of 3.10 have none.
        filtered = {"filter": "data"} if hasattr(tarfile, "data_filter") else {}
        archive.extractall(base, **filtered)  # type: ignore[arg-type]
    return base / f"pcretrieve-{pcretrieve.__version__}"


@pytest.mark.slow
def test_the_source_distribution_has_every_tracked_file(folder: Path) -> None:
    wanted = {name for name in tracked_files() if not name.startswith(ONLY_IN_A_CHECKOUT)}
    assert {name for name in wanted if not (folder / name).is_file()} == set()
    scripts = [name for name in wanted if name.startswith("scripts/")]
    assert [
        name
        for name in scripts
        if (ROOT / name).stat().st_mode != (folder / name).stat().st_mode
    ] == []


@pytest.mark.slow
def test_the_wheel_has_every_file_of_the_package_and_nothing_else(folder: Path) -> None:
    wheel = built("wheel", folder, folder.parent / "wheel")
    assert wheel.name == f"pcretrieve-{pcretrieve.__version__}-py3-none-any.whl"
    with zipfile.ZipFile(wheel) as archive:
        held = {name for name in archive.namelist() if ".dist-info/" not in name}
        archive.extractall(installed := folder.parent / "installed")
    compiled = {name for name in held if name.endswith((".nbi", ".nbc"))}
    assert held - compiled == {
        name for name in tracked_files() if name.startswith("pcretrieve/")
    }
    # A first scan after the installation compiles nothing, even where not even root can write a file.
    home = ("env", f"HOME={installed}", "XDG_CACHE_HOME=", "NUMBA_CACHE_DIR=")
    less = ("setpriv", "--bounding-set=-dac_override", "--inh-caps=-dac_override") * (
        os.geteuid() == 0
    )
    for by in (home, (*home, *less)):
        done = program("lab", "signature", ROOT / "new_scan.ply", cwd=installed, by=by)
        assert "compiling" not in done.stderr
        assert (
            {str(path.relative_to(installed)) for path in installed.rglob("*.nb?")}
            == compiled
            != set()
        )
        subprocess.run(["chmod", "-R", "a-w", installed], check=True)


def test_the_typeface_of_the_pages_is_small_and_has_its_licence() -> None:
    assets = ROOT / "pcretrieve" / "pages" / "assets"
    face = (assets / "typeface.css").read_text(encoding="utf-8")
    (content,) = re.findall(r"data:font/woff2;base64,([^)]*)", face)
    assert b64decode(content, validate=True)[:4] == b"wOF2" and len(face) < 60_000
    licence = (assets / "typeface.LICENSE.txt").read_text(encoding="utf-8")
    assert "SIL OPEN FONT LICENSE Version 1.1" in licence and "Reserved Font" in licence
    assert "Inter" in (ROOT / "docs" / "licences.md").read_text(encoding="utf-8")


def test_the_version_is_that_of_the_other_files() -> None:
    """The changelog begins with the version that the package has, or will have when it is released."""
    for name, pattern in (
        ("CITATION.cff", r"^version: (\S+)$"),
        ("CHANGELOG.md", r"^## \[([\d.]+)\] - "),
    ):
        found = re.findall(
            pattern, (ROOT / name).read_text(encoding="utf-8"), re.MULTILINE
        )
        assert found[0] == pcretrieve.__version__, name


def test_no_dependency_has_a_stricter_licence_than_its_users() -> None:
    """Of all packages that the installed extras for users bring, by what they say and what is linked."""
    waiting = [distribution("pcretrieve")]
    seen: dict[str, str] = {}
    with_supernodal = set()  # a module of CHOLMOD under the GPL
    while waiting:
        package = waiting.pop()
        said = package.metadata.get_all("License-Expression", []) or [
            line
            for line in package.metadata.get_all("Classifier", [])
            if line.startswith("License ::")
        ]
        name = canonicalize_name(package.metadata["Name"])
        seen[name] = "; ".join(said)
        native = [file.locate() for file in package.files or () if ".so" in file.name]
        if any(b"cholmod_super" in Path(file).read_bytes() for file in native):
            with_supernodal.add(name)
        for text in package.requires or ():
            needed = Requirement(text)
            extras = (
                ("", "remote", "postgresql", "all")
                if package.name == "pcretrieve"
                else ("",)
            )
            if needed.marker is None or any(
                needed.marker.evaluate({"extra": extra}) for extra in extras
            ):
                with suppress(PackageNotFoundError):
                    if canonicalize_name(needed.name) not in seen:
                        waiting.append(distribution(needed.name))
    assert {"numpy", "pytetwild", "scipy"} <= seen.keys()
    assert {name: said for name, said in seen.items() if COPYLEFT.search(said)} == {}
    assert with_supernodal == set()
