"""A task with a method, compiled (a trial); experiments, which are many of them; checking specs without running."""
