"""What ``cmbrl info`` says of a scene: as text and as JSON types."""
