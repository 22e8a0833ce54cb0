"""Decision processes on models and on real systems: one definition of reward, termination and reset for all."""

from cmbrl.envs.mdp import MDP

__all__ = ["MDP"]
