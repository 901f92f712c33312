"""Equivariant networks and rsl_rl models built from representations."""
