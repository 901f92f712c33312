"""A robot file from an MJCF, and what to know of a robot before it is trained."""
