"""Which softening of contact trains the best policies of robots: none, constant, by distance, or the published rule."""
