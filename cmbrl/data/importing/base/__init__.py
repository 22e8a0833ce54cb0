"""The base of a floating robot: by motion capture, markers or feet, on the clock of the joints."""
