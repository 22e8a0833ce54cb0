"""Imitation of motions: what a robot is asked to do is a recorded motion, which it tracks."""
