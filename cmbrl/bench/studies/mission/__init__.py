"""What policies earn in the real system, by method, from how much data and computing."""
