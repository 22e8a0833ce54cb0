"""Which joints are the play between a motor and its link (``played`` writes them into a file).

A play is a joint of its own, behind the motor's, with stops at the ends of the gap. The driven joint keeps what is the
motor's: torque, rotor (armature), damping, friction and limits. The play turns or slides along the same axis, freely
within its gap. Its link follows the motor at a distance that no encoder tells: a log has no column of it, and the model
follows it along the log instead (``cmbrl.models.between.following``).
"""

from __future__ import annotations

from collections.abc import Sequence

from cmbrl.scene.records import Joint, JointKind

SUFFIX = "_play"  #: of the play's name, after that of the driven joint


def plays(joints: Sequence[Joint]) -> list[Joint]:
    """Those of ``joints`` that are the play of another one on the same body, by their names."""
    bodies = {joint.name: joint.body for joint in joints if joint.kind != JointKind.BALL}
    return [
        joint
        for joint in joints
        if joint.kind != JointKind.BALL and bodies.get(driven_by(joint.name), -1) == joint.body
    ]


def driven_by(name: str) -> str:
    """The joint whose play is called ``name``; empty if it is not the name of a play."""
    return name.removesuffix(SUFFIX) if name.endswith(SUFFIX) else ""
