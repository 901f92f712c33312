"""Robot and task -> MjSpec -> compiled model, sensors, index maps by name; the two physics engines."""
