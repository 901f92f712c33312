"""Training: rsl_rl's PPO on a kickbench environment, checkpoints, and what a person sees meanwhile."""
