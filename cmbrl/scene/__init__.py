"""What is in the world, and no more: a scene read from an MJCF, reduced, with named parameters."""

from cmbrl.scene.records import LeftOut, Parameter
from cmbrl.scene.scene import Scene

__all__ = ["LeftOut", "Parameter", "Scene"]
