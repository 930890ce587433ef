"""How Sphinx makes the documentation: `make docs`."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parent / "_extensions"), str(Path(__file__).parents[1])]

from cosim import __version__  # noqa: E402

project = "cosim"
author = "The cosim authors"
release = version = __version__
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.doctest",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinxarg.ext",
    "made_pages",
]
exclude_patterns = ["_build"]
nb_execution_mode = "force"
nb_execution_timeout = 600
nb_execution_raise_on_error = True
nb_execution_in_temp = True
html_theme = "furo"
html_title = f"cosim {release}"
html_copy_source = False
html_search_scorer = str(Path(__file__).with_name("search_score.js"))  # opened from the working directory

myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence", "deflist"]
copybutton_exclude = ".linenos, .gp, .go"

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_type_aliases = {"Array": "Array", "IntArray": "IntArray"}
autodoc_preserve_defaults = True
default_role = "literal"  # of docstrings
napoleon_use_rtype = False
napoleon_use_ivar = True
