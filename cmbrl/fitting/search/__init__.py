"""Parameters, the loss of a set of them, and what minimises it."""
