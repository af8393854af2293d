"""How the pages are built: `sphinx-build -W --keep-going -b html docs docs/_build/html`.

Pages are MyST notebooks. Their cells run in the build, each page in an empty folder, and an error
in one of them is an error of the build.
"""

import os
import sys
from importlib.metadata import version as installed_version
from pathlib import Path

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS / "extensions"))

from jaxtube.experiments import environment  # noqa: E402

project = "jaxtube"
author = "the authors of jaxtube"
project_copyright = "the authors of jaxtube, BSD-3-Clause"
version = installed_version("jaxtube")
release = version

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "alternatives",
    "commands",
    "docstrings",
    "mathml",
    "scenario_keys",
]
exclude_patterns = ["_build", "extensions"]

html_theme = "furo"
html_title = f"jaxtube {version}"
html_math_renderer = "mathml"
html_static_path = ["_static"]
html_css_files = ["page.css"]
html_copy_source = False
html_theme_options = {"navigation_with_keys": True}

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4
suppress_warnings = ["mystnb.unknown_mime_type"]

nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_execution_show_tb = True
nb_merge_streams = True
nb_output_stderr = "remove"

autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_typehints = "signature"
autodoc_inherit_docstrings = False
napoleon_numpy_docstring = False
napoleon_attr_annotations = False
napoleon_use_ivar = True
default_role = "literal"
maximum_signature_line_length = 80

# Cells are processes of their own that inherit this: what a command does for itself.
environment.compile_quickly()
environment.keep_compiled_programs()
environment.use_one_thread_for_linear_algebra()
os.environ["JAXTUBE_ROOT"] = str(DOCS.parent)
os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
os.environ["PYTHONPATH"] = os.pathsep.join(
    part for part in (str(DOCS.parent), os.environ.get("PYTHONPATH")) if part
)
