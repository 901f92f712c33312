"""What a run leaves behind: episodes, metrics, provenance, the folder they lie in and the table of them."""
