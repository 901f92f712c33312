"""One run, and whole experiments: which runs they need, their processes, how far they are."""
