"""Run notebooks and write them, with what their cells print and draw, as pages.

Cells run in one process with the build: no kernel and nothing of Jupyter's is needed.
"""

from __future__ import annotations

import ast
import io
import json
from contextlib import redirect_stdout
from pathlib import Path

import matplotlib.pyplot as plt


def write_notebook(notebook: Path, folder: Path) -> None:
    """Run a notebook, and write its page and pictures into a folder.

    Args:
        notebook: an .ipynb file, of Markdown and Python without magic commands.
        folder: gets `<name>.md` and `<name>-<n>.png`.

    Raises:
        RuntimeError: a cell fails.
    """
    parts: list[str] = []
    names: dict[str, object] = {"__name__": "__main__"}
    pictures = 0
    for number, cell in enumerate(json.loads(notebook.read_text("utf-8"))["cells"], start=1):
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(source)
            continue
        parts.append(f"```python\n{source.rstrip(';')}\n```")
        printed = _run(source, names, f"{notebook.name}, cell {number}")
        if printed:
            parts.append(f"```text\n{printed}\n```")
        for each in plt.get_fignums():
            pictures += 1
            name = f"{notebook.stem}-{pictures}.png"
            plt.figure(each).savefig(folder / name, dpi=110)
            plt.close(each)
            parts.append(f"![What the cell draws]({name})")
    (folder / f"{notebook.stem}.md").write_text("\n\n".join(parts) + "\n", "utf-8")


def _run(source: str, names: dict[str, object], where: str) -> str:
    """Run a cell, and return what it prints; as in a notebook, its last value is printed too."""
    tree, printed = ast.parse(source), io.StringIO()
    last = tree.body[-1] if tree.body else None
    try:
        with redirect_stdout(printed):
            if isinstance(last, ast.Expr) and not source.rstrip().endswith(";"):
                exec(compile(ast.Module(tree.body[:-1], []), where, "exec"), names)
                value = eval(compile(ast.Expression(last.value), where, "eval"), names)
                if value is not None:
                    print(repr(value))
            else:
                exec(compile(tree, where, "exec"), names)
    except Exception as error:
        raise RuntimeError(f"{where} failed: {type(error).__name__}: {error}") from error
    return printed.getvalue().strip()
