"""The real system: MuJoCo on hopper.xml with a payload, weaker motors, more joint damping and a slippery foot.

``python -m cmbrl.tasks.hopper_payload.real FILE`` writes that changed file, the truth behind a recorded log.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree import ElementTree

from cmbrl.data.transitions import Transitions
from cmbrl.envs.mujoco_recording import record_mujoco
from cmbrl.errors import UserError
from cmbrl.registry import Task
from cmbrl.system import MujocoSystem

CHANGES = {  # (element of hopper.xml, attribute): (nominal, real)
    ("motor[@joint='thigh_joint']", "gear"): (200.0, 160.0),  # N m at full control
    ("motor[@joint='leg_joint']", "gear"): (200.0, 140.0),
    ("motor[@joint='foot_joint']", "gear"): (200.0, 180.0),
    ("joint[@name='thigh_joint']", "damping"): (1.0, 2.5),  # N m s/rad
    ("joint[@name='leg_joint']", "damping"): (1.0, 2.5),
    ("joint[@name='foot_joint']", "damping"): (1.0, 2.5),
    ("geom[@name='foot_geom']", "friction"): (2.0, 0.6),
    ("geom[@name='floor']", "friction"): (1.0, 0.6),  # MuJoCo takes the larger of the two that touch
}
PAYLOAD = {"name": "payload", "type": "sphere", "size": "0.05", "pos": "0 0 0.1", "mass": "2"}  # in the torso; 2 kg


def write_scene(nominal: str, path: Path) -> Path:
    """Writes the changed copy of the file ``nominal`` to ``path`` and returns ``path``.

    Raises UserError when ``nominal`` is not the hopper.xml that the table was made for.
    """
    root = ElementTree.parse(nominal).getroot()
    for (element, attribute), (_, value) in CHANGES.items():
        _found(root, element, nominal).set(attribute, f"{value:g}")
    payload = ElementTree.SubElement(_found(root, "body[@name='torso']", nominal), "geom", PAYLOAD)
    payload.attrib |= {"contype": "0", "conaffinity": "0"}  # it is inside the torso and touches nothing
    ElementTree.ElementTree(root).write(path, encoding="utf-8")
    return path


def system(nominal: str) -> MujocoSystem:
    """One robot with the changes, stepped as Hopper-v5: four steps of MuJoCo per control step."""
    with TemporaryDirectory() as folder:
        return MujocoSystem(write_scene(nominal, Path(folder) / "hopper_payload.xml"), frame_skip=4)


def record(task: Task, **arguments: Any) -> Transitions:
    """Transitions of the robot in the process of ``task``; ``arguments`` as in `cmbrl.registry.Task.record`."""
    assert task.mdp is not None
    return record_mujoco("hopper_payload", task.mdp(), lambda: system(task.scene_path), **arguments)


def _found(root: ElementTree.Element, element: str, path: str) -> ElementTree.Element:
    node = root.find(f".//{element}")
    if node is None:
        raise UserError(f"{path}: has no {element}; install a gymnasium whose hopper.xml has it (1.0 to 1.4 do)")
    return node


if __name__ == "__main__":
    from cmbrl.tasks.hopper import TASK

    print(write_scene(TASK.scene_path, Path(sys.argv[1])))
