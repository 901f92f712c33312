"""YAML with places, pydantic models of robot, task, method and experiment, and the names of shipped files."""
