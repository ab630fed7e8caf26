"""The documentation site, from the READMEs, the notebooks and the docstrings as they stand.

    python -m sphinx -W --keep-going -q -c .docs . out/site

The table of contents follows the top README; the page of a package lists what its `__all__` offers.
"""

import importlib
import shutil
from pathlib import Path
from typing import get_args

from sphinx.application import Sphinx

CONTENTS = {
    "Tutorial": ("scenarios/first_steps", "scenarios/own_data", "scenarios/gap", "scenarios/RECIPES"),
    "How to": ("rig/lab/README", "rig/README", "rig/recording/README", "identify/REFUSALS", "rig/effects/README"),
    "Theory": ("identify/README", "identify/gaps/README", "rig/model/README"),
    "Reference": ("rig/__init", "identify/__init"),
    "Results": ("scenarios/README", "tests/campaigns/README"),
    "Project": ("CHANGELOG", ".github/CONTRIBUTING"),
}
PACKAGE = "/__init"
"""End of the name of a package's page: its file without `__.py`, as other .py files are no pages."""

project = "Rig and identify"
root_doc = "README"
source_suffix = {".md": "myst-nb", ".ipynb": "myst-nb", "__.py": "restructuredtext"}
include_patterns = [
    root_doc + ".md",
    *(page + suffix for pages in CONTENTS.values() for page in pages for suffix in source_suffix),
]
exclude_patterns = ["out*", "build", ".[!g]*", ".git"]
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.viewcode"]
html_theme = "furo"
html_title = project
html_show_sphinx = False
myst_heading_anchors = 4
myst_enable_extensions = ["dollarmath"]
nb_execution_mode = "off"
autodoc_typehints = "signature"
autodoc_member_order = "bysource"


def with_contents(_app: Sphinx, page: str, source: list[str]) -> None:
    """Append the table of contents to the first page, and write the page of a package from its `__all__`."""
    if page == root_doc:
        source[0] += "".join(
            f"\n```{{toctree}}\n:hidden:\n:caption: {caption}\n\n{chr(10).join(pages)}\n```\n"
            for caption, pages in CONTENTS.items()
        )
    elif page.endswith(PACKAGE):
        source[0] = reference(page.removesuffix(PACKAGE))


def reference(package: str) -> str:
    """Page of a package: its docstring, then each name of its `__all__`."""
    module = importlib.import_module(package)
    lines = [f"{package}: reference", "=" * (len(package) + 11), "", f".. automodule:: {package}", ""]
    for name in module.__all__:
        offered = getattr(module, name)
        for item in get_args(offered) or (offered,):
            kind, options = ("autoclass", ["   :members:"]) if isinstance(item, type) else ("autofunction", [])
            lines += [f".. {kind}:: {item.__module__}.{item.__qualname__}", *options, ""]
    return "\n".join(lines)


def first_page(app: Sphinx, error: Exception | None) -> None:
    if error is None:
        shutil.copyfile(Path(app.outdir) / f"{root_doc}.html", Path(app.outdir) / "index.html")


def setup(app: Sphinx) -> None:
    app.connect("source-read", with_contents)
    app.connect("build-finished", first_page)
