"""The settings of Sphinx for the pages of this folder. `scripts/docs` builds them."""

import os
import sys
from pathlib import Path

# `scripts/docs` says where the package is, because it builds from a copy of this folder.
ROOT = Path(os.environ.get("PCRETRIEVE_ROOT", Path(__file__).resolve().parents[1]))
# Examples simulate scans by scripts/benchmarks.
sys.path[:0] = [str(ROOT), str(ROOT / "scripts"), str(Path(__file__).parent)]

from pcretrieve import __version__  # noqa: E402

project = "pcretrieve"
author = "pcretrieve developers"
project_copyright = "pcretrieve developers, MIT licence"
release = version = __version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "myst_parser",
    "sphinx_gallery.gen_gallery",
    "mathtext",
]
html_math_renderer = "mathtext"
root_doc = "docs/index"
exclude_patterns = ["docs/examples", "docs/_templates"]
templates_path = ["docs/_templates"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}

# Markdown as GitHub shows it: the same anchors of headings, and formulas between dollars.
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4

# Names in single backquotes are code, as in the docstrings; the links of the reference are made by roles.
default_role = "code"
add_module_names = False
autodoc_member_order = "bysource"
autodoc_typehints = "none"
numpydoc_show_class_members = False

# Examples are run when they have changed. Their pages are written beside this file, in `gallery`.
sphinx_gallery_conf = {
    "examples_dirs": str(Path(__file__).parent / "examples"),
    "gallery_dirs": str(Path(__file__).parent / "gallery"),
    "filename_pattern": r"plot_\w+\.py$",
    "ignore_pattern": r"sample\.py$",
    "write_computation_times": False,
    "show_signature": False,
    "show_memory": False,
    "plot_gallery": True,
    "abort_on_example_error": True,
    "capture_repr": (),
    "remove_config_comments": True,
}

html_theme = "pydata_sphinx_theme"
html_title = f"pcretrieve {__version__}"
html_theme_options = {
    "navigation_depth": 2,
    "secondary_sidebar_items": ["page-toc"],
    "show_prev_next": False,
}
html_sidebars: dict[str, list[str]] = {"docs/index": []}
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sourcelink = False
