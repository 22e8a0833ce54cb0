"""Three small studies in modules of their own: one that is well, one that raises, one whose process dies."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from cmbrl.bench.registry import STUDIES
from cmbrl.bench.study import Progress

MODULES = {
    "good_study": """
import os
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Canvas
from cmbrl.bench.study import Figure, Section, Study, Table

def run(folder, settings, runner):
    print("noise of a library")
    os.write(1, b"noise of a C library")
    with (folder / "calls").open("a") as file:
        file.write(os.environ["OMP_NUM_THREADS"])
    figures = []
    for k in range(3):
        runner.progress(k / 3, f"picture {k}")
        canvas = Canvas(figsize=(4, 3))
        FigureCanvasAgg(canvas)
        canvas.subplots().plot([0, k, 1])
        canvas.savefig(folder / f"{k}.png")
        figures.append(Figure(f"{k}.png", f"Curve {k}", "An <i>escaped</i> caption."))
    rows = [[name, 10.0 ** -k, k, "fail" if k else "pass"] for k, name in enumerate("cab")]
    rows.append(["none", None, float("inf"), "fail: 3 of 5"])
    table = Table("Errors", ["solver", "error", "count", "verdict"], rows, "smaller is better")
    return Section("Good <study>", "First & foremost.\\n\\nSecond.", [table], figures, {"x": float("nan")})

STUDY = Study("good", "a study that is well", run, ("hopper",))
""",
    "raising_study": """
from cmbrl.bench.study import Study
def run(folder, settings, progress):
    raise ZeroDivisionError("no <such> number")
STUDY = Study("raising", "a study that raises", run)
""",
    "dying_study": """
import os, signal
from cmbrl.bench.study import Study
def run(folder, settings, progress):
    print("last words", flush=True)
    os.kill(os.getpid(), signal.SIGSEGV)
STUDY = Study("dying", "a study whose process dies", run)
""",
    "refusing_study": """
from cmbrl.bench.study import Study
from cmbrl.errors import UserError
def run(folder, settings, progress):
    raise UserError("solver missing: pip install it")
STUDY = Study("refusing", "a study that needs what is not there", run)
""",
}
FAKES = {name.removesuffix("_study"): name for name in MODULES}


@pytest.fixture
def fakes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, str]]:
    """Name -> module of the studies above, in place of the real ones; in the same dictionary, whoever imported it."""
    place = tmp_path / "modules"
    place.mkdir()
    for name, text in MODULES.items():
        (place / f"{name}.py").write_text(text, encoding="utf-8")
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.syspath_prepend(place)  # a spawned process gets sys.path
    real = dict(STUDIES)
    STUDIES.clear()
    STUDIES.update(FAKES)
    yield FAKES
    STUDIES.clear()
    STUDIES.update(real)


@contextmanager
def no_bar(name: str) -> Iterator[Progress]:
    yield lambda share, text: None
