"""The blocks of docs/python.md run one after another, and end where the page says."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

PAGE = (Path(__file__).parents[2] / "docs/python.md").read_text(encoding="utf-8")


def test_the_page_does_what_it_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (scene,) = re.findall(r"^```xml\n(.*?)^```", PAGE, flags=re.MULTILINE | re.DOTALL)
    Path("puck.xml").write_text(scene, encoding="utf-8")
    told: dict[str, Any] = {}
    for code in re.findall(r"^```python\n(.*?)^```", PAGE, flags=re.MULTILINE | re.DOTALL):
        exec(compile(code, "docs/python.md", "exec"), told)
    assert told["found"]["friction.puck"] == pytest.approx(0.3, rel=0.02)
    assert told["found"]["gear.push"] == pytest.approx(0.8, rel=0.02)
    np.testing.assert_allclose(told["xs"][-1][[0, 2]], [0.5, 0.0], atol=0.02)
    assert told["forwards"].shape == (16, 2, 16, 2)
    torch.testing.assert_close(told["forwards"], told["backwards"], rtol=1e-9, atol=1e-9)
