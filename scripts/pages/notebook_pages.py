"""``python -m stillpoint.scripts.pages.notebook_pages``: run the notebooks of docs/, write a page of each.

The notebooks are kept without results; the pages, which the site shows, are made from a run.
"""

import base64
from pathlib import Path

import nbformat
from nbclient import NotebookClient

from stillpoint.scripts.program import run_program

_FOLDER = Path("docs/notebooks")
_FIGURES = Path("docs/figures/notebooks")
_LONGEST_S = 900  # of one cell


def main() -> None:
    """Write a page beside each notebook, and its figures."""
    _FIGURES.mkdir(parents=True, exist_ok=True)
    for path in sorted(_FOLDER.glob("*.ipynb")):
        text, figures = make_page(path)
        path.with_suffix(".md").write_text(text, encoding="utf-8")
        for name, content in figures.items():
            (_FIGURES / name).write_bytes(content)


def make_page(path: Path) -> tuple[str, dict[str, bytes]]:
    """Run a notebook; return the text of a page with code and results, and its figures by the names of their files.

    Raises ``nbclient.exceptions.CellExecutionError`` for a cell that fails.
    """
    notebook = nbformat.read(path, as_version=4)
    NotebookClient(notebook, timeout=_LONGEST_S, kernel_name="python3").execute()
    figures: dict[str, bytes] = {}
    parts = []
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            parts.append(cell.source)
            continue
        parts.append(f"```python\n{cell.source}\n```")
        for output in cell.outputs:
            if output.output_type == "stream" and output.name == "stdout":
                parts.append(f"```\n{output.text.rstrip()}\n```")
            elif "image/png" in output.get("data", {}):
                name = f"{path.stem}-{len(figures) + 1}.png"
                figures[name] = base64.b64decode(output.data["image/png"])
                parts.append(f"![Figure of the code above](../figures/notebooks/{name})")
    parts.insert(1, f"[Download this notebook]({path.name}).")
    return "\n\n".join(parts) + "\n", figures


if __name__ == "__main__":
    run_program(main)
