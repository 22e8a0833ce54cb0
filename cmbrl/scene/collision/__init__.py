"""What may touch what, by which law: shapes, pairs of them, and pairs that never meet."""
