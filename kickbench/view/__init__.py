"""Pictures: starts of a task, episodes of a policy, sampling regions from above."""
