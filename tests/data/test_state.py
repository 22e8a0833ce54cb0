"""Arrays of MuJoCo's whole state, as scripts with its bindings save them: qpos, qvel and ctrl."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from cmbrl import UserError
from cmbrl.data.importing import Imported, Options, import_logs
from cmbrl.data.importing.build import Frames
from cmbrl.data.plausible.frames import to_world
from cmbrl.data.transitions import Transitions
from cmbrl.scene import Scene

ROBOT = """<mujoco><worldbody><geom type="plane" size="5 5 .1"/>
<body pos="-.3 0 .06"><joint name="push" type="slide" axis="1 0 0" damping="4"/>
<joint name="lift" axis="0 1 0" damping="1"/><geom size=".025" mass=".6"/></body>
<body pos="0 0 .4"><freejoint name="box"/><geom type="box" size=".08 .06 .05" mass="1"/></body>
<body pos="1 0 1"><joint name="swivel" type="ball" damping=".1"/><geom type="box" pos="0 0 -.2" size=".02 .03 .2"/>
</body></worldbody><actuator><motor name="pusher" joint="push" gear="10"/></actuator></mujoco>"""
ROWS, EVERY = 300, 5


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    file = tmp_path_factory.mktemp("state") / "robot.xml"
    file.write_text(ROBOT, encoding="utf-8")
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    data.qvel[:] = 0.1, 0.3, 0.5, -0.2, 0.4, 3.0, 1.0, -2.0, 1.0, 0.5, 2.0
    found: dict[str, list] = {"qpos": [], "qvel": [], "ctrl": []}
    for row in range(ROWS):
        data.ctrl[:] = np.sin(0.1 * row)
        for name, rows in found.items():
            rows.append(getattr(data, name).copy())
        mujoco.mj_step(model, data, EVERY)
    arrays = {name: np.array(rows) for name, rows in found.items()} | {"time": 0.002 * EVERY * np.arange(ROWS)}
    return SimpleNamespace(scene=Scene.from_mjcf(file), arrays=arrays)


def brought(robot: SimpleNamespace, folder: Path, names: dict[str, str] | None = None, **options: object) -> Imported:
    """What comes of the arrays, some under other ``names``."""
    arrays = {(names or {}).get(name, name): array for name, array in robot.arrays.items()}
    np.savez(folder / "log.npz", **arrays)
    return import_logs([folder / "log.npz"], robot.scene, Options(**options))  # type: ignore[arg-type]


def check(found: Imported, robot: SimpleNamespace) -> None:
    assert isinstance(found.log, Transitions)
    np.testing.assert_allclose(found.log.q, robot.arrays["qpos"][:-1], atol=1e-9)
    np.testing.assert_allclose(found.log.v, robot.arrays["qvel"][:-1], atol=1e-9)
    np.testing.assert_allclose(found.log.u, robot.arrays["ctrl"][:-1], atol=1e-9)


def test_they_are_known_by_their_names(robot: SimpleNamespace, tmp_path: Path) -> None:
    found = brought(robot, tmp_path)
    check(found, robot)
    (note,) = [note for note in found.notes if "MuJoCo's order" in note]
    assert note.startswith("qpos, qvel, ctrl: ")
    assert note.endswith("angular velocities in the axes of the body")


def test_they_can_be_told(robot: SimpleNamespace, tmp_path: Path) -> None:
    names = {"qpos": "a", "qvel": "b", "ctrl": "c"}
    check(brought(robot, tmp_path, names, columns={"a": "position", "b": "velocity", "c": "control"}), robot)


def test_what_is_told_of_a_column_counts_more(robot: SimpleNamespace, tmp_path: Path) -> None:
    log = brought(robot, tmp_path, columns={"qpos[0]": "push.position:m+.5"}).log
    assert isinstance(log, Transitions)
    np.testing.assert_allclose(log.q[:, 0], robot.arrays["qpos"][:-1, 0] + 0.5, atol=1e-9)
    np.testing.assert_allclose(log.q[:, 1:], robot.arrays["qpos"][:-1, 1:], atol=1e-9)


def test_another_frame_can_be_told(robot: SimpleNamespace, tmp_path: Path) -> None:
    qpos, qvel = robot.arrays["qpos"], robot.arrays["qvel"].copy()
    for turn, rate in ((slice(5, 9), slice(5, 8)), (slice(9, 13), slice(8, 11))):
        qvel[:, rate] = to_world(qpos[:, turn], qvel[:, rate])
    world = SimpleNamespace(scene=robot.scene, arrays=robot.arrays | {"qvel": qvel})
    check(brought(world, tmp_path, frames=Frames("world")), robot)


def test_a_table_has_them_in_numbered_columns(robot: SimpleNamespace, tmp_path: Path) -> None:
    arrays = robot.arrays
    table = np.column_stack([arrays["time"], *(arrays[name] for name in ("qpos", "qvel", "ctrl"))])
    widths = {name: arrays[name].shape[1] for name in ("qpos", "qvel", "ctrl")}
    header = ["time", *(f"{name}_{k}" for name, width in widths.items() for k in range(width))]
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=",".join(header), comments="")
    check(import_logs([tmp_path / "log.csv"], robot.scene, Options()), robot)


@pytest.mark.parametrize(
    ("columns", "told"),
    [
        ({}, r"no column for push.position: .* as --map a=position;"),
        ({"b": "position"}, r"'b' has 11 columns and the robot 2 joints \(13 numbers with free and ball joints\)"),
    ],
)
def test_one_line_says_what_to_do(columns: dict[str, str], told: str, robot: SimpleNamespace, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=told):
        brought(robot, tmp_path, {"qpos": "a", "qvel": "b"}, columns=columns)
