"""examples/notebook.ipynb runs from its first cell to its last."""

import json
from pathlib import Path

import matplotlib
import numpy as np

NOTEBOOK = json.loads((Path(__file__).resolve().parents[2] / "examples/notebook.ipynb").read_text())


def test_notebook_runs_and_its_firmware_predicts_the_same_bits(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    matplotlib.use("Agg")
    names = {}
    for cell in NOTEBOOK["cells"]:
        if cell["cell_type"] == "code":
            exec(compile("".join(cell["source"]), "notebook", "exec"), names)
    assert "the same bits" in capsys.readouterr().out
    missed, moved = (np.abs(names[a] - names["ends"])[:, :2].mean() for a in ("ahead", "began"))
    assert missed < 0.5 * moved


def test_notebook_has_at_most_fifteen_cells_and_stores_no_outputs():
    assert len(NOTEBOOK["cells"]) <= 17 and all(not cell.get("outputs") for cell in NOTEBOOK["cells"])
