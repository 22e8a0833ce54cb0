"""Torques of drivers that compensate gravity: they tell what comes on top of the weight that the driver holds itself.

A driver computes that weight by its own model, which is taken to be the file. What the robot weighs more, such as a
payload, stays for the torques to hold, and for a fit to find.
"""

from __future__ import annotations

from collections.abc import Sequence

from cmbrl.data.importing.bodies import joints_of
from cmbrl.data.importing.build import Episode, configurations
from cmbrl.data.importing.commands.commanded import Commanded
from cmbrl.errors import UserError
from cmbrl.scene import Scene
from cmbrl.scene.info.columns import counted
from cmbrl.scene.kinematics import holding_forces


def added(episodes: Sequence[Episode], scene: Scene) -> tuple[list[Episode], list[str]]:
    """``episodes`` with what the links weigh by the file in their torques, and a sentence that says so.

    Raises UserError for a log without torques of joints, or a file that compensates gravity itself.
    """
    keys = set(episodes[0])
    commanded, places = Commanded.of(keys, scene), {joint.name: joint.vadr for joint in joints_of(scene)[0]}
    torques = [key for key in commanded.keys if key[1] == "torque"] if commanded else []
    if not commanded or len(torques) < len(commanded.keys):
        raise UserError(
            "--gravity-compensated is about torques of joints, and this log commands no or other actuators: leave it "
            "out, and let the file compensate (gravcomp of its bodies)"
        )
    if scene.core.nlift:
        raise UserError(
            f"--gravity-compensated, and bodies of {scene.name!r} have gravcomp: the weight would be held twice; leave "
            "out one of them"
        )
    found: list[Episode] = []
    for episode in episodes:
        weight = holding_forces(scene.core, configurations(episode, scene))
        held = {key: episode[key] + weight[:, [places[key[0]]]] for key in torques}
        found.append({**episode, **held})
    return found, [f"the weight of the links by the file was added to {counted(len(torques), 'torque')}"]
