"""Columns of a format that tells no units: what they are taken for is said, and what they cannot be is asked."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from cmbrl import Scene, UserError
from cmbrl.data.importing import Imported, Options, import_logs

DT, ROWS = 1 / 30, 90
ARM = """<mujoco><worldbody><body><joint name="elbow" axis="0 1 0" range="-100 90"/>
<geom type="capsule" size=".03" fromto="0 0 0 .2 0 0"/><body pos=".2 0 0">
<joint name="gripper" axis="0 1 0" range="-10 100"/><geom type="capsule" size=".01" fromto="0 0 0 .05 0 0"/>
</body></body></worldbody><actuator><position name="elbow" joint="elbow" kp="20" kv="1"/>
<position name="gripper" joint="gripper" kp="5" kv=".2"/></actuator></mujoco>"""


def read(folder: Path, elbow: float, gripper: tuple[float, float], options: Options) -> Imported:
    """A dataset whose elbow swings by ``elbow`` to both sides and whose gripper goes between the two numbers."""
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    (folder / "arm.xml").write_text(ARM)
    (folder / "set/meta").mkdir(parents=True)
    (folder / "set/data").mkdir()
    feature = {"dtype": "float32", "shape": [2], "names": ["elbow.pos", "gripper.pos"]}
    info = {"codebase_version": "v3.0", "features": {"observation.state": feature, "action": feature}}
    (folder / "set/meta/info.json").write_text(json.dumps(info))
    time = DT * np.arange(ROWS)
    swing = np.column_stack([elbow * np.sin(3 * time), gripper[0] + np.ptp(gripper) * (0.5 - 0.5 * np.cos(2.5 * time))])
    columns = {
        "observation.state": arrow.array(swing.tolist()), "action": arrow.array(np.roll(swing, -1, axis=0).tolist()),
        "timestamp": time, "episode_index": np.zeros(ROWS, dtype=np.int64),
    }  # fmt: skip
    parquet.write_table(arrow.table(columns), folder / "set/data/file.parquet")
    return import_logs([folder / "set"], Scene.from_mjcf(folder / "arm.xml"), options)


def test_radians_are_said_to_be_taken(tmp_path: Path) -> None:
    found = read(tmp_path, 1.2, (0.0, 1.5), Options())
    assert "2 hinges of LeRobot, which tells no units, are taken in rad" in found.notes
    assert np.abs(found.log.position).max() == pytest.approx(1.5, abs=0.01)


def test_what_cannot_be_radians_is_asked(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"-79.99 to 79.97.* --angles deg.*elbow.position:\+-percent"):
        read(tmp_path, 80.0, (0.0, 100.0), Options())


def test_a_gripper_in_degrees_may_be_a_share_of_its_range(tmp_path: Path) -> None:
    """0 to 100 of its range is nearly the same in degrees, so that no limit tells."""
    found = read(tmp_path, 80.0, (0.0, 99.0), Options(angles="deg"))
    told = [note for note in found.notes if "gripper.position:percent" in note]
    assert len(told) == 1
    assert "observation.state.gripper.pos goes from 0 to" in told[0]


def test_mapped_columns_need_no_assumption(tmp_path: Path) -> None:
    columns = {
        f"{where}.{name}.pos": f"{name}.{what}:{unit}"
        for where, what in (("observation.state", "position"), ("action", "command"))
        for name, unit in (("elbow", "+-percent"), ("gripper", "percent"))
    }
    found = read(tmp_path, 80.0, (0.0, 100.0), Options(columns=columns))
    assert not [note for note in found.notes if "LeRobot" in note]
    assert found.log.position.max(axis=0) == pytest.approx(np.radians([71, 100]), abs=0.01)
