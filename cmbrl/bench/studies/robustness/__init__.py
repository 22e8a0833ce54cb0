"""How often the solver reaches its tolerance on wild random states."""
