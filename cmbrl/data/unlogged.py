"""Joints that no sensor tells, the plays of a file (``cmbrl.scene.fittable.play``): a log has no columns of them.

In a log as the scene has it, their columns are 0 from the first row to the last, which no play ever does that moves.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from cmbrl.scene.fittable.play import plays

if TYPE_CHECKING:
    from cmbrl.data.transitions import Transitions
    from cmbrl.scene import Scene
    from cmbrl.scene.records import Joint


def with_columns(log: Transitions, scene: Scene) -> Transitions:
    """``log`` with columns of zeros for the plays of ``scene``, where it has those of all its other joints alone."""
    missing = plays(scene.joints)
    if not missing or (log.q.shape[1], log.v.shape[1]) != (scene.nq - len(missing), scene.nv - len(missing)):
        return log
    q_told, v_told = np.ones(scene.nq, dtype=bool), np.ones(scene.nv, dtype=bool)
    q_told[[joint.qadr for joint in missing]] = v_told[[joint.vadr for joint in missing]] = False
    arrays: dict[str, Any] = {}
    for name, told in (("q", q_told), ("v", v_told), ("q_next", q_told), ("v_next", v_told)):
        arrays[name] = np.zeros((len(log), len(told)))
        arrays[name][:, told] = getattr(log, name)
    own = {joint.name for joint in missing}
    known = tuple(name for name in scene.joint_names if name not in own) == log.joint_names
    return replace(log, **arrays, joint_names=scene.joint_names if known else log.joint_names)


def unlogged(log: Transitions, scene: Scene) -> list[Joint]:
    """The plays of ``scene`` that ``log`` does not tell."""
    return [
        joint
        for joint in plays(scene.joints)
        if not (log.q[:, joint.qadr].any() or log.q_next[:, joint.qadr].any() or log.v[:, joint.vadr].any())
    ]
