"""One page to look at for every fit: pictures inside it, nothing loaded from elsewhere."""
