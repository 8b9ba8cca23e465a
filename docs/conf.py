"""Settings of the site. ``python -m sphinx -W -b html docs site`` builds it from the Markdown pages, without network.

The lists of docs/index.md are the menu. A link to a page or an anchor that is not there stops the build, and so does a
page that the lists do not name.
"""

import re
from typing import TYPE_CHECKING

from tofmix.version import __version__

if TYPE_CHECKING:
    from sphinx.application import Sphinx

project = "tofmix"
author = "the tofmix authors"
release = __version__
root_doc = "index"
exclude_patterns = ["figures", "generators"]

extensions = ["myst_parser"]
myst_heading_anchors = 4  # headings are anchors, named as a forge names them
suppress_warnings = ["myst.header"]  # generated pages skip a level of headings

html_theme = "furo"
html_title = f"tofmix {__version__}"
html_show_copyright = False
html_copy_source = False

_SECTION = re.compile(r"^## (.+)$", re.MULTILINE)
_PAGE = re.compile(r"^- \[.+?\]\((.+?)\.md\)", re.MULTILINE)


def _add_menu(_app: "Sphinx", name: str, source: list[str]) -> None:
    """Append a table of contents for each section of the index, so that a plain viewer sees lists alone."""
    if name != root_doc:
        return
    _, *parts = _SECTION.split(source[0])
    for caption, text in zip(parts[::2], parts[1::2], strict=True):
        pages = "\n".join(_PAGE.findall(text))
        source[0] += f"\n```{{toctree}}\n:hidden:\n:caption: {caption}\n\n{pages}\n```\n"


def setup(app: "Sphinx") -> None:
    """Connect the menu to the build."""
    app.connect("source-read", _add_menu)
