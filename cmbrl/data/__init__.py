"""Logs of transitions: read, checked, split and written, or recorded from a real system."""

from cmbrl.data.trajectories import read_trajectories
from cmbrl.data.transitions import Transitions

__all__ = ["Transitions", "read_trajectories"]
