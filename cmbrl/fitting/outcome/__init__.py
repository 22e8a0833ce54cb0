"""What a fit found: intervals, what the log leaves open, what it is worth on unseen episodes, as text and as a page."""
