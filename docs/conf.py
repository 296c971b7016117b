"""The site of the docs: `make site` builds it into build/site, without a network."""

from polemap import __version__

project = "polemap"
author = "The polemap authors"
copyright = author
version = release = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.mathjax"]
source_suffix = {".md": "markdown"}
exclude_patterns = ["examples", "pictures"]
myst_enable_extensions = ["dollarmath", "amsmath"]
myst_heading_anchors = 3
# pages also link to files of the repository, which are no pages of the site
suppress_warnings = ["myst.xref_missing", "myst.header"]

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
napoleon_google_docstring = True

html_theme = "furo"
html_title = f"polemap {__version__}"
html_show_sourcelink = False
html_copy_source = False
# equations are typeset by the browser; without a network they stay readable as TeX
