"""Tasks, targets and observations."""
