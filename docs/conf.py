"""Configuration of the site: `pip install ".[docs]"`, then `sphinx-build -W docs site`."""

import re
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from command_pages import write_command_tables
from scene_pages import write_scene_sections

from swe_sphere import __version__
from swe_sphere.files.fingerprints import code_fingerprint

project = "swe_sphere"
author = "the swe_sphere developers"
version = release = __version__
root_doc = "index"
exclude_patterns = ["_build", "reference/generated"]

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",  # formulas are set without a network too
    "sphinx.ext.viewcode",
]
myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence", "html_image"]
myst_heading_anchors = 4
nb_execution_mode = "off"  # the tests execute the notebooks; their outputs are in them
autodoc_typehints = "description"
autodoc_member_order = "bysource"
autodoc_class_signature = "separated"

html_theme = "furo"
html_static_path = ["site.css"]
html_css_files = ["site.css"]
html_show_copyright = False
html_title = f"swe_sphere {release}"
html_theme_options = {"navigation_with_keys": True}


CODE = re.compile(r"\bcode (?:of swe_sphere |`)([0-9a-f]{16})|code of an earlier version")
"""Stamps of measurements."""
OLDER = """

```{note}
Numbers of this page were measured with another version of the code or of its libraries than this
site describes: their stamps state commit and date. `python -m benchmarks` measures them again.
```
"""


def _mark_older(app, docname, source):
    """Add a note under the title of a page with measurements that the current code did not make."""
    measured = {found[1] for found in CODE.finditer(source[0])}
    if measured - {code_fingerprint()}:
        title, end, text = source[0].partition("\n")
        source[0] = title + OLDER + end + text


def setup(app):
    app.connect("builder-inited", _write_generated_pages)
    app.connect("source-read", _mark_older)


def _write_generated_pages(app):
    """Write the pages that are made of the program, before Sphinx lists all pages."""
    reference = Path(app.srcdir) / "reference"
    write_scene_sections(reference / "generated" / "scenes.md")
    write_command_tables(reference / "generated" / "commands.md")
