"""Imitation of motions: what a robot is asked to do is a recorded motion, which it tracks."""

from cmbrl.imitation.motion import Motion
from cmbrl.imitation.robot import Robot, imitation_task

__all__ = ["Motion", "Robot", "imitation_task"]
