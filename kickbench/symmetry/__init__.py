"""The mirror group C2, its representations and field tables, and the mirror of a model."""
