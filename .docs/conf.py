"""The documentation site, from the READMEs, the notebooks and the docstrings as they stand.

    python -m sphinx -W --keep-going -q -c .docs . out/site

The table of contents stands beside the top README, which is the first page. The page of a package lists what its
`__all__` offers. A link from a README to a file that is no page becomes a download.
"""

import importlib
import re
import shutil
import textwrap
from inspect import isfunction
from pathlib import Path
from typing import get_args

from sphinx.application import Sphinx

CONTENTS = {
    "Tutorial": ("scenarios/first_steps", "scenarios/own_data", "scenarios/gap", "scenarios/RECIPES"),
    "How to": ("rig/lab/README", "rig/README", "rig/recording/README", "rig/effects/README", "identify/REFUSALS"),
    "Theory": ("identify/README", "identify/gaps/README", "rig/model/README"),
    "Reference": ("rig/__init", "identify/__init"),
    "Results": ("scenarios/README", "tests/campaigns/README"),
    "Project": ("CHANGELOG", ".github/CONTRIBUTING"),
}
PACKAGE = "/__init"
"""End of the name of a package's page: its file without `__.py`, as other .py files are no pages."""
OUTSIDE = "ABC,Struct,ValueError,object"
"""Bases whose members the reference leaves out."""

project = html_title = "Rig and identify"
root_doc = "README"
source_suffix = {".md": "myst-nb", ".ipynb": "myst-nb", "__.py": "restructuredtext"}
include_patterns = [
    page + suffix for pages in ((root_doc,), *CONTENTS.values()) for page in pages for suffix in source_suffix
]
exclude_patterns = ["out*", "build", ".git", ".venv", ".*_cache"]
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.viewcode"]
default_role = "code"
html_theme = "furo"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_show_sphinx = html_show_copyright = html_copy_source = False
highlight_language = "text"  # of blocks that name none: commands, diagrams
myst_heading_anchors = 4
nb_execution_mode = "off"
add_module_names = False
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True


def with_contents(_app: Sphinx, page: str, source: list[str]) -> None:
    """Append the table of contents to the first page, and write the page of a package from its `__all__`."""
    if page == root_doc:
        for caption, pages in CONTENTS.items():
            source[0] += f"\n```{{toctree}}\n:hidden:\n:caption: {caption}\n\n{chr(10).join(pages)}\n```\n"
    elif page.endswith(PACKAGE):
        source[0] = reference(page.removesuffix(PACKAGE))


def reference(package: str) -> str:
    """Page of a package: its docstring, then the functions and the classes of its `__all__`; of a union, each class."""
    module = importlib.import_module(package)
    title = f"{package}: reference"
    lines = [title, "=" * len(title), "", f".. automodule:: {package}", "   :no-members:", ""]
    for name in sorted(module.__all__, key=lambda name: not isfunction(getattr(module, name))):
        offered = getattr(module, name)
        lines += [name, "-" * len(name), ""]
        for item in get_args(offered) or (offered,):
            options = ["   :members:", f"   :inherited-members: {OUTSIDE}"] if isinstance(item, type) else []
            kind = "autoclass" if options else "autofunction"
            lines += [f".. {kind}:: {item.__module__}.{item.__qualname__}", *options, ""]
    return "\n".join(lines)


def as_rst(_app: Sphinx, _kind: str, _name: str, _item: object, _options: object, lines: list[str]) -> None:
    """Turn the indented code of a docstring into a block of code."""
    text = re.sub(r"(?<=\n\n)((?: {4}.*\n|\n)+)", r".. code-block:: python\n\n\1", "\n".join(lines))
    lines[:] = textwrap.dedent(text).split("\n")


def first_page(app: Sphinx, error: Exception | None) -> None:
    """Copy the first page to where a browser looks for it."""
    if error is None:
        shutil.copyfile(Path(app.outdir) / f"{root_doc}.html", Path(app.outdir) / "index.html")


def setup(app: Sphinx) -> None:
    app.connect("source-read", with_contents)
    app.connect("autodoc-process-docstring", as_rst)
    app.connect("build-finished", first_page)
