"""Configuration of the documentation; `python -m docs` builds it and opens it."""

from __future__ import annotations

import os
import sys
from pathlib import Path

DOCS = Path(__file__).resolve().parent
sys.path.insert(0, str(DOCS / "_ext"))
# The examples import one another from the root of the repository.
sys.path.insert(0, str(DOCS.parent))
# The blocks of the examples are small: several BLAS threads would wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import factorgraph_adj  # noqa: E402

project = "factorgraph_adj"
author = "factorgraph_adj maintainers"
copyright = f"2026, {author}"
version = release = factorgraph_adj.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",
    "sphinx_gallery.gen_gallery",
    "sphinx_copybutton",
    "docstrings",
    "kinds",
    "checklist",
]
exclude_patterns = ["_build", "_ext", "Thumbs.db", ".DS_Store"]
# A class has two names, that of the package and that of its module.
suppress_warnings = ["ref.python"]

# Pages: Markdown with formulas between dollar signs.
myst_enable_extensions = ["dollarmath", "amsmath", "deflist", "colon_fence", "attrs_inline"]
myst_heading_anchors = 3
myst_dmath_double_inline = True

# Single backticks in docstrings name code.
default_role = "code"
autoclass_content = "both"
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
# Names of types that are shown as such.
NAMED = ("Array", "Index", "Mask", "Frame", "Sigma", "State", "LensResult", "MoveBy")
autodoc_type_aliases = {name: name for name in NAMED}
autodoc_default_options = {"members": True}
toc_object_entries_show_parents = "hide"
python_use_unqualified_type_names = True
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_rtype = False
add_module_names = False
maximum_signature_line_length = 88

sphinx_gallery_conf = {
    "examples_dirs": ["../examples"],
    "gallery_dirs": ["gallery"],
    # Every script is run and writes its picture itself, as it does from the command line.
    "filename_pattern": r"\.py$",
    "ignore_pattern": r"(make_.*|__init__)\.py$",
    "image_scrapers": ("pictures.written_picture",),
    "reset_argv": "pictures.arguments",
    "within_subsection_order": "FileNameSortKey",
    "abort_on_example_error": True,
    "download_all_examples": False,
    "remove_config_comments": True,
    "default_thumb_file": str(DOCS / "_static" / "industry_block.png"),
    "show_memory": False,
    "show_signature": False,
    "plot_gallery": "True",
    "min_reported_time": 1e9,
    "write_computation_times": False,
}

# Prompts and output are not copied with a command.
copybutton_prompt_text = r"\$ "
copybutton_prompt_is_regexp = True
copybutton_only_copy_prompt_lines = True

html_theme = "furo"
html_title = f"factorgraph_adj {release}"
html_static_path = ["_static"]
html_css_files = ["style.css"]
html_show_sphinx = False
html_copy_source = False
html_theme_options = {"navigation_with_keys": True}
