"""Tasks that come with cmbrl: one folder each, known to it only by their entry points."""
