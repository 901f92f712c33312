"""Whole experiments: which runs they need, running them in processes of their own, and how far they are."""
