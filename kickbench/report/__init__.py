"""The report: one self-contained page that puts measured results beside reported ones, and the README's part."""
