"""pcretrieve: raw 3D scans of things that bend in, ranked shapes out.

The public names are those of ``__init__.pyi``. Each is imported from its room when it is first used, so that
``import pcretrieve`` takes no time (SPEC 1 of Scientific Python).
"""

import logging

import lazy_loader

__version__ = "0.2.0"

# Without it, warnings of a library go to standard error where the program has not set up logging.
logging.getLogger("pcretrieve").addHandler(logging.NullHandler())

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__all__ += ["__version__"]
