"""From a file, a text or a specification to a compiled MuJoCo model, and its elements by name."""
