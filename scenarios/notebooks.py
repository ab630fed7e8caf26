"""Execution of the notebooks: outputs are stored small, with a hash of the cells that they come from.

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
SOURCES_KEY = "sources_sha256"
"""Key of a notebook's metadata: the hash of the cells from which its outputs come."""
COLOUR_COUNT, WIDTH_PX = 128, 640
"""Colours and largest width of a stored figure: some 20 kB."""
PNG, HTML = "image/png", "text/html"
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
            notebook = execute_notebook(json.loads(path.read_text(encoding="utf-8")))
            progress(1.0)
        write_bytes((json.dumps(notebook, indent=1, ensure_ascii=False) + "\n").encode(), path)


def execute_notebook(notebook: Notebook) -> Notebook:
    """Notebook with the outputs of its executed cells: figures as small PNG, tables and figures without their text."""
    with needs_extra("docs", "executing a notebook"):
        import nbformat
        from nbclient import NotebookClient
    with TemporaryDirectory() as folder:
        executed = nbformat.reads(json.dumps(notebook), nbformat.NO_CONVERT)
        NotebookClient(executed, timeout=None, resources={"metadata": {"path": folder}}).execute()
    content: Notebook = json.loads(nbformat.writes(executed))
    for cell in content["cells"]:
        cell["metadata"] = {}  # the times of the execution
        for output in cell.get("outputs", ()):
            data = output.get("data", {})
            if HTML in data:
                data["text/plain"] = ["(a table)"]
            if PNG in data:
                data[PNG] = shrink_png(data[PNG])
                data["text/plain"] = ["(a figure)"]
    content["metadata"] = {**notebook["metadata"], SOURCES_KEY: sources_sha256(content)}
    return content


def shrink_png(plot: str) -> str:
    """PNG in base64 with few colours, which keep thin lines as they are, and at most `WIDTH_PX` wide."""
    from PIL import Image

    image = Image.open(BytesIO(b64decode(plot))).convert("RGB")
    image.thumbnail((WIDTH_PX, image.height))
    file = BytesIO()
    image.quantize(COLOUR_COUNT, Image.Quantize.MAXCOVERAGE).save(file, "png", optimize=True)
    return b64encode(file.getvalue()).decode()


if __name__ == "__main__":
    run(app, "scenarios.notebooks")
