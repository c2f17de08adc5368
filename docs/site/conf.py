"""Sphinx's settings for the site; `scripts/site` calls it."""

import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

sys.path.insert(0, str(Path(__file__).parents[2]))
from formulas import unbroken

from zeno_orbits import __version__

project = "zeno_orbits"
version = release = __version__
html_title = f"zeno_orbits {__version__}"
html_theme = "furo"
html_static_path = ["static"]
html_css_files = ["site.css"]
# Commands and programs are copied, their outputs are not.
copybutton_selector = "div.highlight-sh pre, div.highlight-python pre"
html_copy_source = False
html_show_copyright = False
html_show_sphinx = False
root_doc = "index"

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx-mathjax-offline",
    "docstrings",
]

# Markdown as GitHub reads it.
myst_enable_extensions = ["dollarmath"]
myst_fence_as_directive = ["math"]
myst_heading_anchors = 3
myst_update_mathjax = False
mathjax_path = "mathjax/tex-chtml.js"  # the extension's own copy: no page asks the network

# Notebooks hold their outputs; a test compares these with what the code of this commit prints.
nb_execution_mode = "off"
nb_output_stderr = "remove"

# A docstring names its arguments; the annotations stand in the signature already.
autodoc_member_order = "bysource"
autodoc_class_signature = "mixed"
autodoc_typehints = "signature"
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 80
default_role = "code"
napoleon_numpy_docstring = False
# The attributes of a frozen dataclass are the arguments that make one.
napoleon_custom_sections = [("Attributes", "params_style")]
napoleon_attr_annotations = False
autodoc_type_aliases = {"Vector": "Vector"}


def setup(app: Any) -> None:
    """Change pages after they are rendered."""

    def keep_options(
        _app: Any, _name: str, _template: str, context: dict[str, Any], _: Any
    ) -> None:
        context["body"] = unbroken(context.get("body", ""))

    app.connect("html-page-context", keep_options)
