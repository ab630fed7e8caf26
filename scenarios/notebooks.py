"""The notebooks with their outputs, kept small: executed again, and marked with what they were executed from.

python -m scenarios.notebooks
"""

import hashlib
import json
from base64 import b64decode, b64encode
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import typer

from rig.commands.command_line import progress_bar, run
from rig.extras import needs_extra
from rig.files import write_bytes

app = typer.Typer(pretty_exceptions_enable=False)

FOLDER = Path(__file__).parent
SOURCES = "sources_sha256"
"""Key of a notebook's metadata: the hash of the cells from which its outputs come."""
COLOURS, WIDTH_PX = 128, 640
"""Colours and largest width of a stored figure: some 20 kB."""
PLOT, HTML = "image/png", "text/html"
Notebook = dict[str, Any]


def sources_sha256(notebook: Notebook) -> str:
    """SHA-256 of kind and text of every cell."""
    cells = [(cell["cell_type"], "".join(cell["source"])) for cell in notebook["cells"]]
    return hashlib.sha256(json.dumps(cells).encode()).hexdigest()


@app.command()
def execute(
    notebooks: Annotated[list[Path] | None, typer.Argument(help="Notebooks; by default all of the scenarios.")] = None,
) -> None:
    """Execute notebooks in a folder of their own, and store their outputs in them."""
    paths = notebooks or sorted(FOLDER.glob("*.ipynb"))
    for path in paths:
        with progress_bar(f"executing {path.name}") as progress:
            notebook = executed(json.loads(path.read_text(encoding="utf-8")))
            progress(1.0)
        write_bytes((json.dumps(notebook, indent=1, ensure_ascii=False) + "\n").encode(), path)


def executed(notebook: Notebook) -> Notebook:
    """Notebook with the outputs of its cells, as small as they need be."""
    with needs_extra("docs", "executing a notebook"):
        import nbformat
        from nbclient import NotebookClient
    with TemporaryDirectory() as folder:
        node = nbformat.reads(json.dumps(notebook), nbformat.NO_CONVERT)
        NotebookClient(node, timeout=None, resources={"metadata": {"path": folder}}).execute()
    result: Notebook = json.loads(nbformat.writes(node))
    for cell in result["cells"]:
        cell["metadata"] = {}  # the times of the execution
        for output in cell.get("outputs", ()):
            shown = output.get("data", {})
            if HTML in shown:
                shown["text/plain"] = ["(a table)"]
            if PLOT in shown:
                shown[PLOT] = smaller(shown[PLOT])
                shown["text/plain"] = ["(a figure)"]
    result["metadata"] = {**notebook["metadata"], SOURCES: sources_sha256(result)}
    return result


def smaller(plot: str) -> str:
    """PNG in base64 with few colours, which keep thin lines as they are, and at most `WIDTH_PX` wide."""
    from PIL import Image

    image = Image.open(BytesIO(b64decode(plot))).convert("RGB")
    image.thumbnail((WIDTH_PX, image.height))
    file = BytesIO()
    image.quantize(COLOURS, Image.Quantize.MAXCOVERAGE).save(file, "png", optimize=True)
    return b64encode(file.getvalue()).decode()


if __name__ == "__main__":
    run(app, "scenarios.notebooks")
