"""How the stiffness of contact decides what a model can learn."""
