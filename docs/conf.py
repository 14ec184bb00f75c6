"""The documentation site: `make docs` builds it offline into build/docs, and every warning is an error."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

from docsite import methods, reference, settings  # noqa: E402 - found through the path above

from feel321 import __version__  # noqa: E402

project = "feel321"
author = "the feel321 authors"
copyright = "2026, the feel321 authors"  # noqa: A001 - Sphinx's name
version = release = __version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "numpydoc",
    "docsite.mathml",
    "docsite.plot",
    "docsite.accessible",
]
myst_heading_anchors = 4
numpydoc_show_class_members = False
autodoc_typehints = "none"  # the docstrings give types, shapes and units
default_role = "py:obj"
nitpicky = True
nitpick_ignore_regex = [
    ("py:obj", ".*")
]  # single backquotes in docstrings name arguments and fields too
exclude_patterns = ["docsite", "_static"]

html_theme = "furo"
html_title = "feel321"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_math_renderer = "mathml"
html_show_sphinx = html_copy_source = html_show_sourcelink = False
pygments_style, pygments_dark_style = "a11y-high-contrast-light", "a11y-high-contrast-dark"

GENERATED = HERE / "reference"
reference.write_index(HERE / "index.rst")
reference.write_faces(GENERATED)
reference.write_verbs(GENERATED / "verbs.rst")
reference.write_tables(GENERATED / "tables.rst")
methods.write_reducers(GENERATED / "reducers.rst")
methods.write_metrics(GENERATED / "metrics.rst")
settings.write_settings(GENERATED / "settings.rst")
