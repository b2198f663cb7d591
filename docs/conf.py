# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Settings of Sphinx for the site; `make docs` builds it."""

import os
import sys
from pathlib import Path

import uw_visibility

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE / "_ext"))
# Figures of the tutorials are kept, not shown.
os.environ["MPLBACKEND"] = "agg"

project = "uw_visibility"
author = "the uw_visibility developers"
copyright = "2026, the uw_visibility developers"
release = version = uw_visibility.__version__

extensions = [
    "sphinx.ext.autodoc",
    "myst_parser",
    "numpydoc",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
    "mathml",
    "reference_pages",
]
exclude_patterns = ["_build", "generated", "examples"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}

smartquotes = False  # what is shown is what code says and messages hold
myst_enable_extensions = ["colon_fence", "dollarmath", "deflist"]
myst_heading_anchors = 3

default_role = "py:obj"
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # numpydoc's sections say shapes and units, which annotations cannot
autodoc_mock_imports = ["rclpy"]
numpydoc_show_class_members = False

sphinx_gallery_conf = {
    "examples_dirs": "examples",
    "gallery_dirs": "tutorials",
    "filename_pattern": r"/\d+_",
    "within_subsection_order": "FileNameSortKey",
    "download_all_examples": False,
    "show_signature": False,
    "write_computation_times": False,
    "min_reported_time": 10_000,
    "thumbnail_size": (640, 360),
    "abort_on_example_error": True,
    "remove_config_comments": True,
}
suppress_warnings = ["config.cache"]

html_math_renderer = "mathml"
html_theme = "pydata_sphinx_theme"
html_title = "uw_visibility"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_js_files = ["site.js"]
html_show_sourcelink = False
html_copy_source = False
html_context = {"default_mode": "auto"}
html_theme_options = {
    "navbar_align": "left",
    "show_prev_next": True,
    "header_links_before_dropdown": 6,
    "footer_start": ["copyright"],
    "footer_end": ["sphinx-version"],
    "secondary_sidebar_items": ["page-toc"],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
