"""Draws of a fit that changed nothing, because the file was right."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np

from cmbrl import ComplementarityModel, Scene
from cmbrl.fitting.result import FitResult

XML = """<mujoco><worldbody><body><joint type="slide" axis="1 0 0" damping="1"/><geom size=".1"/></body></worldbody>
</mujoco>"""


def test_draws_of_a_fit_that_changed_nothing_are_the_file(tmp_path: Path) -> None:
    (tmp_path / "right.xml").write_text(XML, encoding="utf-8")
    model = ComplementarityModel(Scene.from_mjcf(tmp_path / "right.xml"))
    known = {p.name: SimpleNamespace(nominal=p.nominal) for p in model.scene.parameters}
    result = FitResult(model, known, {"covariance": {"parameters": [], "matrix": []}})  # type: ignore[arg-type]
    np.testing.assert_allclose(result.draws(3), model.parameters[None].repeat(3, axis=0))
