"""The build of the package, with its loops compiled for this computer: no first scan waits for them."""

import subprocess
import sys

from setuptools import setup
from setuptools.command.build_py import build_py

COMPILE = "from pcretrieve.pipeline.process import compile_stages; compile_stages()"


class BuildCompiled(build_py):
    """The modules, and what numba compiles of them, in their `__pycache__`."""

    def run(self) -> None:
        """Copy the modules, and compile their loops. A build that cannot leaves it to the first scan."""
        super().run()
        folder = "." if self.editable_mode else self.build_lib
        subprocess.run([sys.executable, "-B", "-c", COMPILE], cwd=folder, check=False)


setup(cmdclass={"build_py": BuildCompiled})
