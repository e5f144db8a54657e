"""The notebook for the first five minutes: every cell runs, and it is kept without outputs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pytest

NOTEBOOK = Path(__file__).parent.parent / "examples" / "quickstart.ipynb"


def code_cells(path: Path = NOTEBOOK) -> list[dict[str, Any]]:
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    return [cell for cell in cells if cell["cell_type"] == "code"]


def run_cells(cells: list[dict[str, Any]]) -> dict[str, Any]:
    """Execute cells one after the other in one namespace, as a notebook does; what a cell raises is raised."""
    names: dict[str, Any] = {"__name__": "__main__"}
    for number, cell in enumerate(cells, 1):
        exec(compile("".join(cell["source"]), f"cell {number}", "exec"), names)
    return names


@pytest.mark.site
@pytest.mark.filterwarnings("ignore:FigureCanvasAgg is non-interactive")
def test_every_cell_runs(capsys: pytest.CaptureFixture[str]) -> None:
    import matplotlib.pyplot as plt

    backend = mpl.get_backend()
    mpl.use("Agg")
    try:
        names = run_cells(code_cells())
        above, curve = names["figure"].axes
    finally:
        plt.close("all")
        mpl.use(backend)
    assert len(names["rewards"]) == len(curve.lines[0].get_xdata()) > 100
    truth, estimate = (line.get_xydata() for line in above.lines)
    assert truth.shape == estimate.shape == (len(names["rewards"]) + 1, 2)
    rms_m = (((truth - estimate) ** 2).sum(axis=1).mean()) ** 0.5
    assert rms_m == pytest.approx(names["info"]["scores"]["ate_m"], rel=1e-6), "the picture shows the scored scene"
    out = capsys.readouterr().out
    assert "LINEAR  0.00" in out
    assert "HUBER   0.00" in out
    assert "HUBER - LINEAR: " in out


def test_a_cell_that_fails_fails_the_run() -> None:
    with pytest.raises(ZeroDivisionError):
        run_cells([{"source": ["x = 1\n"]}, {"source": ["x / 0\n"]}])


def test_no_output_is_kept() -> None:
    """Outputs grow old, and make every change unreadable."""
    assert len(code_cells()) >= 4
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in code_cells())
