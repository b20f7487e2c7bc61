"""What the robot is asked to do: tasks, targets and observations."""
