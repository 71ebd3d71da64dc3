"""Configure Sphinx, which makes the site from these pages (`make site`)."""

from __future__ import annotations

import sys
from importlib import metadata
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))  # sphinx-gallery imports `look` from here

project = author = "becalm"
release = metadata.version("becalm")
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_gallery.gen_gallery"]
exclude_patterns = ["gallery"]  # the scripts; sphinx-gallery writes their pages into gallery_pages

html_theme = "furo"
html_title = "becalm"
html_copy_source = False
html_show_copyright = False

myst_heading_anchors = 3

autodoc_typehints = "none"  # the docstrings have the types, with shapes and units
autodoc_preserve_defaults = True
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_rtype = False

sphinx_gallery_conf = {
    "examples_dirs": "gallery",
    "gallery_dirs": "gallery_pages",
    "filename_pattern": r"\.py$",
    "within_subsection_order": "look.PageOrder",
    "image_scrapers": ["look.as_svg"],
    "reset_modules": ["look.same_look"],
    "capture_repr": (),
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
    "min_reported_time": 1e9,
}
