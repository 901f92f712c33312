"""A task with a method, compiled (a trial); experiments, which are many; checking specs without running."""
