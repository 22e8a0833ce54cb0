"""The failure bank: scenes where contact simulators break, each with its truth, run by ours and by other simulators."""
