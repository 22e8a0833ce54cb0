"""The numbers of a scene that a fit may change."""
