"""Runs the notebook docs/examples/first_pick.ipynb and writes what it gives: ``uv run python -m docs.notebook``.

Jupyter is not needed: the code cells run in order in one namespace, as Jupyter runs them.
"""

from __future__ import annotations

import ast
import base64
import io
import json
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

NOTEBOOK = Path(__file__).with_name("examples") / "first_pick.ipynb"
_INDENT = 1


def run(notebook: dict[str, Any], namespace: dict[str, Any]) -> dict[str, Any]:
    """The notebook with the outputs of its code cells, run in ``namespace``."""
    cells, number = [], 0
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            number += 1
            given = _outputs("".join(cell["source"]), number, namespace)
            cell = {**cell, "execution_count": number, "outputs": given}
        cells.append(cell)
    return {**notebook, "cells": cells}


def _outputs(source: str, number: int, namespace: dict[str, Any]) -> list[dict[str, Any]]:
    """Return what one code cell prints, and its last value if that is an expression."""
    *before, last = ast.parse(source).body
    body = before if isinstance(last, ast.Expr) else [*before, last]
    value: Any = None
    with redirect_stdout(io.StringIO()) as printed:
        exec(compile(ast.Module(body, []), f"<cell {number}>", "exec"), namespace)
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), f"<cell {number}>", "eval"), namespace)
    text = printed.getvalue()
    stream = [{"output_type": "stream", "name": "stdout", "text": text.splitlines(keepends=True)}] if text else []
    return stream if value is None else [*stream, _result(value, number)]


def _result(value: Any, number: int) -> dict[str, Any]:
    data: dict[str, Any] = {"text/plain": [repr(value)]}
    if hasattr(value, "_repr_png_"):
        data["image/png"] = base64.b64encode(value._repr_png_()).decode()
    return {"output_type": "execute_result", "execution_count": number, "metadata": {}, "data": data}


def main() -> None:
    """Run the notebook, and write it with its outputs."""
    notebook = run(json.loads(NOTEBOOK.read_text()), {})
    NOTEBOOK.write_text(json.dumps(notebook, indent=_INDENT, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
