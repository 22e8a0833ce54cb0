"""Scenes: worlds read from an MJCF, with named parameters."""

from cmbrl.scene.records import LeftOut, Parameter
from cmbrl.scene.scene import Scene

__all__ = ["LeftOut", "Parameter", "Scene"]
