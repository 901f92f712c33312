"""The figures of a page: each a file, each pure functions from typed data to a picture."""
