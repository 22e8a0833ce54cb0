"""Measurements: model error on a log, speed against other simulators."""
