"""The joints of a scene as a log speaks of them: hinges and slides with one number, free and ball joints with many."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cmbrl.scene.records import JointKind

if TYPE_CHECKING:
    from cmbrl.scene import Scene

PLACE, TURN = ("x", "y", "z"), ("qw", "qx", "qy", "qz")
QUATERNION = "quaternion"  #: the quantity of all four columns together
LINEAR, ANGULAR = ("vx", "vy", "vz"), ("wx", "wy", "wz")


@dataclass(frozen=True)
class Single:
    """A hinge or a slide."""

    name: str
    hinge: bool
    limited: bool
    qadr: int
    vadr: int


@dataclass(frozen=True)
class Floating:
    """A free joint, or a ball joint without ``place``."""

    name: str
    free: bool
    qadr: int
    vadr: int

    @property
    def position(self) -> dict[str, int]:
        """Places in q by quantity."""
        return {name: self.qadr + k for k, name in enumerate((*(PLACE if self.free else ()), *TURN))}

    @property
    def velocity(self) -> dict[str, int]:
        """Places in v by quantity."""
        return {name: self.vadr + k for k, name in enumerate((*(LINEAR if self.free else ()), *ANGULAR))}


def joints_of(scene: Scene) -> tuple[list[Single], list[Floating]]:
    """The joints of the file, in its order."""
    single, floating = [], []
    limited = set(scene.core.lim_line.tolist())
    for source, name in enumerate(scene.joint_names):
        parts = [joint for joint in scene.joints if joint.source == source]
        q, v = min(part.qadr for part in parts), min(part.vadr for part in parts)
        if any(part.kind == JointKind.BALL for part in parts):
            floating.append(Floating(name, len(parts) > 1, q, v))
        else:
            single.append(Single(name, parts[0].kind == JointKind.HINGE, v in limited, q, v))
    return single, floating
