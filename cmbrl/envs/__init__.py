"""Decision processes on models and on real systems: one definition of reward, termination and reset for all."""
