"""Pictures of a robot, drawn without a display."""
