"""Trajectories of simulators: seconds of processor per simulated second against the error that is left."""
