"""The files of a leg, in a package."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.urdf.leg import robot, stl


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    for folder, scale in (("a", 1.0), ("b", 2.0)):
        (tmp_path / "src/leg" / folder).mkdir(parents=True)
        (tmp_path / "src/leg" / folder / "shape.stl").write_bytes(stl(scale))
    (tmp_path / "src/leg/urdf").mkdir()
    path = tmp_path / "src/leg/urdf/leg.urdf"
    path.write_text(robot())
    return path
