"""The failure bank: scenes where contact simulators break, each with its truth in closed form, run by ours and rivals."""
