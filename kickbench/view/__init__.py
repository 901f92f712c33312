"""Pictures: initial states of a task, episodes of a policy, sampling regions from above."""
