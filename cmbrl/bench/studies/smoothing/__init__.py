"""Which softening of contact descends best to a throw that hits: none, constant, by distance, or the published rule."""
