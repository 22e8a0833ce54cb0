"""Hidden real systems: policies for robots that are not those of their file."""
