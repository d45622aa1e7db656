"""pcretrieve: raw 3D scans of things that bend in, ranked shapes out.

The public names are those of ``__init__.pyi``. Each is imported from its room when it is first used, so that
``import pcretrieve`` takes no time (SPEC 1 of Scientific Python).
"""

import atexit
import logging
import os
from pathlib import Path

import lazy_loader

__version__ = "0.2.0"

# Without it, warnings of a library go to standard error where the program has not set up logging.
logging.getLogger("pcretrieve").addHandler(logging.NullHandler())

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__all__ += ["__version__"]


def _lend_compiled(cache: str | Path) -> None:
    """Copy what setup.py has compiled to a cache of numba, which reads none that it cannot write."""
    from hashlib import sha1
    from shutil import copyfile

    for file in sorted(Path(__file__).parent.rglob("__pycache__/*.nb[ci]")):
        room = file.parents[1]
        copy = Path(cache, f"{room.name}_{sha1(str(room).encode()).hexdigest()}", file.name)
        copy.parent.mkdir(parents=True, exist_ok=True)
        if not copy.exists() or copy.stat().st_mtime < file.stat().st_mtime:
            part = copy.with_suffix(f".{os.getpid()}")  # no other process sees half of it
            copyfile(file, part)
            part.replace(copy)


if not os.access(Path(__file__).parent, os.W_OK):
    try:
        home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        _lend_compiled(os.environ.get("NUMBA_CACHE_DIR") or Path(home, "numba"))
    except (OSError, RuntimeError):  # a home that cannot be written, or none
        from tempfile import TemporaryDirectory

        folder = TemporaryDirectory(prefix="pcretrieve-", ignore_cleanup_errors=True)
        atexit.register(folder.cleanup)
        os.environ["NUMBA_CACHE_DIR"] = folder.name
        _lend_compiled(folder.name)
