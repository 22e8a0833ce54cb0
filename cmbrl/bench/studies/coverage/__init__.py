"""Whether the intervals of fits hold the truth where the model is wrong."""
