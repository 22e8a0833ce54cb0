"""A training run in a folder: iterations, metrics, checkpoints and what they rest on."""
