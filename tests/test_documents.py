"""The documents agree with the code: links have ends, names are in the reference, commands and Python run."""

from __future__ import annotations

import re
import runpy
import shlex
import subprocess
from functools import partial
from pathlib import Path

import pytest
import pytetwild
from commands import NAMES, run
from packaging.version import Version

import pcretrieve

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
DOCKERFILE = (ROOT / "Dockerfile").read_text(encoding="utf-8")
DOCUMENTS = sorted(
    [*ROOT.glob("*.md"), ROOT / "scans" / "README.md", *(ROOT / "docs").rglob("*.md")]
)
# Workflows that have passed once; the others say in their first line that they have not.
RUN: set[str] = set()
ALL = "".join(
    path.read_text(encoding="utf-8") for path in DOCUMENTS if path.name != "CHANGELOG.md"
)


def prose(document: Path) -> str:
    """The text of a document without its blocks of code."""
    return re.sub(
        r"^```.*?^```$",
        "",
        document.read_text(encoding="utf-8"),
        flags=re.MULTILINE | re.DOTALL,
    )


def anchors(document: Path) -> set[str]:
    """The anchors that GitHub and Sphinx give to headings."""
    headings = re.findall(r"^#+ (.+)$", prose(document), re.MULTILINE)
    return {
        re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings
    }


def test_no_link_is_dead() -> None:
    seen = 0
    for document in DOCUMENTS:
        text = re.sub(r"`[^`\n]*`", "", prose(document))
        for link in re.findall(r"\]\(([^)\s]+)\)", text):
            if "://" in link:
                continue
            name, _, anchor = link.partition("#")
            end = document.parent / name if name else document
            assert end.exists(), (document, link)
            assert not anchor or anchor in anchors(end), (document, link)
            seen += 1
    assert seen > 20


def test_every_page_is_in_one_table_of_contents() -> None:
    docs, contents = ROOT / "docs", r"^```\{toctree\}\n:hidden:\n\n(.*?)^```$"
    texts = ((docs / page).read_text("utf-8") for page in ("index.md", "guide.md"))
    named = [
        re.findall(contents, text, re.MULTILINE | re.DOTALL)[0].split() for text in texts
    ]
    header, others = ([(docs / name).resolve() for name in names] for names in named)
    assert header == [docs / "gallery" / "index", docs / "guide", docs / "reference"]
    pages = {page.with_suffix("") for page in DOCUMENTS} - {docs / "index"} | {*header}
    assert sorted(header + others) == sorted(pages)


def test_the_reference_has_the_public_names_and_no_others() -> None:
    names = re.findall(
        r"^   (\w+)$", (ROOT / "docs" / "reference.rst").read_text("utf-8"), re.M
    )
    assert sorted(names) == sorted({*pcretrieve.__all__} - {"__version__"})


def test_the_page_of_options_is_that_of_the_code() -> None:
    """Written by docs/option_tables.py."""
    written = runpy.run_path(str(ROOT / "docs" / "option_tables.py"))["page"]()
    assert (ROOT / "docs" / "options.md").read_text("utf-8") == written


def test_the_reference_has_the_verbs_of_a_catalogue_and_no_others() -> None:
    text = (ROOT / "docs" / "reference.rst").read_text("utf-8")
    verbs = [name for name in dir(pcretrieve.Catalogue) if not name.startswith("_")]
    assert re.findall(r"^   Catalogue\.(\w+)$", text, re.M) == verbs
    assert len(verbs) <= 16
    assert all(getattr(pcretrieve.Catalogue, name).__doc__ for name in verbs)


def test_the_dockerfile_says_what_the_project_says() -> None:
    """Where no Docker builds it: what it names is what the project has."""
    text, project = (
        DOCKERFILE.replace("\\\n", ""),
        (ROOT / "pyproject.toml").read_text("utf-8"),
    )
    (python,) = re.findall(r"^FROM python:([\d.]+)-slim", text, re.M)
    assert f'"Programming Language :: Python :: {python}"' in project
    (libraries,) = re.findall(r"--no-install-recommends (.+?) &&", text)
    (named,) = re.findall(r"system libraries (.+?)\.\s", README)
    assert libraries.split() == re.split(r", | and ", named)
    copied = [
        name for line in re.findall(r"^COPY (.+) /", text, re.M) for name in line.split()
    ]
    assert {"pyproject.toml", "setup.py", "pcretrieve"} < {*copied}
    assert all((ROOT / name).exists() for name in copied)
    (command,) = re.findall(r'^ENTRYPOINT \["(.+?)"', text, re.M)
    assert f"\n{command} = " in project


def test_workflows_run_what_is_there_and_say_whether_they_ever_ran() -> None:
    yaml = pytest.importorskip("yaml")
    project = (ROOT / "pyproject.toml").read_text("utf-8")
    commands: set[str] = set()
    for path in sorted((ROOT / ".github" / "workflows").glob("*.yml")):
        text = path.read_text("utf-8")
        assert text.startswith("# Never run yet") or path.stem in RUN, path.name
        for job in yaml.safe_load(text)["jobs"].values():
            for python in job.get("strategy", {}).get("matrix", {}).get("python", ()):
                assert f'"Programming Language :: Python :: {python}"' in project, (
                    path.name
                )
            commands |= {step["run"] for step in job["steps"] if "run" in step}
    called = {
        script for command in commands for script in re.findall(r"^scripts/\w+", command)
    }
    assert called == {"scripts/check", "scripts/test", "scripts/docs"}
    assert {"scripts/test", "scripts/test --all"} <= commands
    for form in (ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml"):
        fields = yaml.safe_load(form.read_text("utf-8"))
        assert (
            form.stem == "config" or {"name", "description", "body"} <= fields.keys()
        ), form.name


def test_the_image_has_locked_packages_and_no_root() -> None:
    lines = [
        line
        for line in DOCKERFILE.replace("\\\n", "").splitlines()
        if line and not line.startswith("#")
    ]
    installs = [line for line in lines if "pip install" in line]
    assert [line for line in installs if "--require-hashes" not in line] == [
        line for line in installs if "--no-deps --no-build-isolation /source" in line
    ]
    (locked,) = (line for line in installs if "--require-hashes" in line)
    assert "-r /source/requirements.lock" in locked
    copied = [
        line for line in lines if line.startswith("COPY") and "requirements.lock" in line
    ]
    assert lines.index(copied[0]) < lines.index(locked)
    # The user is there before it is used, and nothing is installed by it.
    (user,) = (line for line in lines if line.startswith("USER"))
    made = next(
        line for line in lines if f"useradd --create-home {user.split()[1]} " in line
    )
    assert lines.index(installs[-1]) < lines.index(made) < lines.index(user)
    assert f"chown {user.split()[1]} /data" in made
    assert not any(line.startswith("RUN") for line in lines[lines.index(user) :])


def test_the_lock_has_no_version_with_a_known_weakness() -> None:
    """Lower bounds are those of corrections, and the lock is above all lower bounds."""
    lock = (ROOT / "requirements.lock").read_text("utf-8")
    project = (ROOT / "pyproject.toml").read_text("utf-8")
    for name, least in (("h11", "0.16"), ("pillow", "10.3"), ("starlette", "0.49.1")):
        (bound,) = re.findall(rf'"{name}>=([\d.]+)"', project)
        assert Version(bound) >= Version(least)
        locked = re.findall(rf"^{name}==([\d.]+)", lock, re.M)
        assert locked and all(Version(one) >= Version(bound) for one in locked)


def test_libraries_inside_packages_are_named_with_their_licences() -> None:
    folder = Path(pytetwild.__file__).parents[1] / "pytetwild.libs"
    shipped = {path.name.partition("-")[0] for path in folder.iterdir()}
    licences = (ROOT / "docs" / "licences.md").read_text("utf-8")
    # The run-time library of GCC has an exception for programs that it compiled.
    assert shipped - {"libgomp"} == {"libgmp"} and "| GMP, " in licences


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_the_image_is_built_and_makes_signatures() -> None:
    docker = partial(subprocess.run, cwd=ROOT, check=True, capture_output=True, text=True)
    try:
        docker(["docker", "info"])
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("no Docker runs here")
    docker(["docker", "build", "--network", "host", "-t", "pcretrieve", "."])
    scan = "scans/person-1/person-1_walk.ply"
    made = docker(
        [
            "docker",
            "run",
            "--rm",
            "-v",
            f"{ROOT}:/data:ro",
            "pcretrieve",
            "lab",
            "signature",
            scan,
        ]
    )
    assert "person-1_walk" in made.stdout


def test_commands_of_the_documents_exist() -> None:
    """Every option that a document shows is one that the command has, and every help has an example."""
    text = re.sub(r"^```.*?^```$", "", ALL, flags=re.MULTILINE | re.DOTALL) + DOCKERFILE
    shown = re.findall(r"^(?: {4}|# docker .* )(pcretrieve .*)$", text, re.MULTILINE)
    lines = [shlex.split(line, comments=True) for line in shown]
    assert len(lines) > 40
    helps: dict[tuple[str, ...], str] = {}
    for words in lines:
        command = tuple(words[1:3] if words[1] in ("catalogue", "lab") else words[1:2])
        if command not in helps:
            helps[command] = "".join(
                run(*command, flag, code=None).output for flag in ("--help", "--help-all")
            )
        for word in words[2:]:
            if word.startswith("-"):
                assert re.search(rf"(^|[\s,]){re.escape(word)}\b", helps[command]), words
    for name in NAMES:
        assert f"  pcretrieve {name}" in run(*name.split(), "--help").output, name


def test_the_readme_is_short_and_documents_name_every_command_and_script() -> None:
    assert README.count("\n") <= 90
    assert [name for name in NAMES if f"`{name.removeprefix('lab ')}" not in ALL] == []
    scripts = {path.name for path in (ROOT / "scripts").iterdir() if path.is_file()} - {
        "setup"
    }
    assert [name for name in sorted(scripts) if f"scripts/{name}" not in ALL] == []
