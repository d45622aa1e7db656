"""The build of the package, with its loops compiled for this computer: no first scan waits for them."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

COMPILE = "from pcretrieve.pipeline.process import compile_stages; compile_stages()"


class BuildCompiled(build_py):
    """The modules, and what numba compiles of them, in their `__pycache__`, beside their sources too.

    Python imports the sources, and not what is installed, where it runs in their folder.
    """

    def run(self) -> None:
        """Copy the modules, and compile their loops. A build that cannot leaves it to the first scan."""
        super().run()
        folder = "." if self.editable_mode else self.build_lib
        # Without bytecode, also of the second process that compiles: it would come into the wheel.
        bare = os.environ | {"PYTHONDONTWRITEBYTECODE": "1"}
        subprocess.run([sys.executable, "-c", COMPILE], cwd=folder, env=bare, check=False)
        if not self.editable_mode:
            for compiled in Path(folder).rglob("*.nb[ci]"):
                source = compiled.relative_to(folder)
                source.parent.mkdir(exist_ok=True)
                shutil.copy(compiled, source)


setup(cmdclass={"build_py": BuildCompiled})
