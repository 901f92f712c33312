"""Fixed-seed evaluation of policies, on the task's starts and on their exact mirror images."""
