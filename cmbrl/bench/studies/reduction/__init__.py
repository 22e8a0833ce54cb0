"""What it saves to model no more than a scene needs, and that the motion stays the same."""
