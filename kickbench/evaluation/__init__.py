"""Fixed-seed evaluation of policies, on the task's initial states and on their exact mirror images."""
