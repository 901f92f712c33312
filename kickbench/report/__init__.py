"""The report: one self-contained page of measured beside reported results, and the READMEs' parts."""
