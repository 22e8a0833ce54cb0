"""Which parameters and laws a fit moves, judged on episodes held out in turn."""
