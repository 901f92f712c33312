"""Observation, reward, termination and randomisation terms: pure batched torch functions, named by YAML."""
