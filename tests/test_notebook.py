"""The notebook runs from top to bottom, and shows figures, tables and pages where it says so."""

import os
from pathlib import Path

import pytest

NOTEBOOK = Path(__file__).parent.parent / "examples" / "notebook.ipynb"


@pytest.fixture(scope="module")
def outputs(tmp_path_factory):
    """The kinds of output of each code cell, by its last line."""
    nbformat = pytest.importorskip("nbformat")
    nbclient = pytest.importorskip("nbclient")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    where = {"path": str(tmp_path_factory.mktemp("notebook"))}
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(NOTEBOOK.parents[1])}
    client = nbclient.NotebookClient(
        notebook, timeout=300, kernel_name="python3", resources={"metadata": where}
    )
    client.execute(env=environment)
    return {
        cell.source.splitlines()[-1]: {kind for out in cell.outputs for kind in out.get("data", {})}
        for cell in notebook.cells
        if cell.cell_type == "code"
    }


@pytest.mark.slow
def test_every_cell_shows_what_it_ends_with(outputs):
    figures = [line for line in outputs if line.startswith("ea.plot(")]
    assert len(figures) == 2
    for line in figures:
        assert "image/png" in outputs[line], line
    tables = ("controller.gains", "record", "found")
    pages = [line for line in outputs if line.startswith(("ea.view(", "ea.report(", "ea.carried("))]
    assert len(pages) == 3
    for line in (*tables, *pages):
        assert "text/html" in outputs[line], line


def test_it_is_kept_without_outputs():
    """So that a change of it can be read, and what it shows is what the library makes."""
    nbformat = pytest.importorskip("nbformat")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(not cell.outputs and cell.execution_count is None for cell in code)
