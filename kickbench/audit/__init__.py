"""The audit: proves the tables of a reflection against geometry and physics, and measures policies."""
