"""The studies: one folder each, known to the others only by :mod:`cmbrl.bench.registry`."""
