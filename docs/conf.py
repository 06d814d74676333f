"""How the pages are made: ``sphinx-build -W --keep-going -b html docs build/docs``.

Nothing is fetched, neither while the pages are built nor when they are read.
"""

import sys
from pathlib import Path
from pydoc import locate

from numpydoc.xref import DEFAULT_LINKS

import spectra_kit
from spectra_kit._core.version import VERSION

sys.path.insert(0, str(Path(__file__).parent / "extensions"))
for page in Path(__file__).parent.glob("api/generated/*.rst"):  # of a build before
    if locate(page.stem) is None:  # a name that is no longer there
        page.unlink()

project = "spectra_kit"
author = "The spectra_kit authors"
project_copyright = author
version = release = VERSION

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",  # one page for each public name: docs/api/generated, not committed
    "numpydoc",
    "myst_nb",
    "sphinx_copybutton",
    # Small ones of our own, in docs/extensions:
    "command_help",
    "notebook_pages",
    "package_list",
    "short_names",
]
templates_path = ["_templates"]
exclude_patterns = ["_templates", "extensions", "pictures"]
default_role = "py:obj"  # `eigensolve` in a docstring is a link
toc_object_entries = False  # the page of a class has its methods in view anyway

autodoc_typehints = "none"  # the docstrings have the types, and the shapes
autodoc_member_order = "bysource"
autosummary_generate_overwrite = True
numpydoc_show_class_members = False  # the template of a class shows them, with their docstrings
numpydoc_class_members_toctree = False
# Types of arguments are links too, where they are ours; the words around them stay words.
DEFAULT_LINKS.clear()  # to the pages of Python and NumPy, which need a network
numpydoc_xref_param_type = True
numpydoc_xref_ignore = "all"
numpydoc_xref_aliases = {name: f"sk.{name}" for name in dir(spectra_kit) if name[0].isupper()}

myst_heading_anchors = 3
myst_enable_extensions = ["attrs_block", "colon_fence"]
# Notebooks are committed without outputs: they are run once, and again when their code changes.
nb_execution_mode = "cache"
nb_execution_in_temp = True  # for what they write
nb_execution_timeout = 300  # seconds of one cell
nb_execution_raise_on_error = True
nb_output_stderr = "error"  # a warning of a cell is one of the build
nb_merge_streams = True
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

html_title = "spectra_kit"
html_theme = "pydata_sphinx_theme"
html_static_path = ["_static"]
html_css_files = ["style.css"]
html_favicon = "_static/logo.svg"
html_copy_source = False
html_show_sourcelink = False
html_context = {"default_mode": "auto"}  # light or dark as the reader's system has it
html_sidebars = {page: [] for page in ("quickstart", "gallery", "measurements")}  # nothing below
html_theme_options = {
    "logo": {
        "text": "spectra_kit",
        "image_light": "_static/logo.svg",
        "image_dark": "_static/logo.svg",
    },
    "header_links_before_dropdown": 6,
    "navbar_align": "left",
    "navbar_persistent": [],
    "navbar_end": ["search-button", "theme-switcher"],
    "navigation_with_keys": False,
    "collapse_navigation": True,  # of a package that one does not look at, no names: smaller pages
    "show_nav_level": 1,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": ["theme-version"],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
