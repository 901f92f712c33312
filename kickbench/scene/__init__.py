"""RobotSpec + TaskSpec -> MjSpec -> compiled model, sensors, and index maps by name."""
