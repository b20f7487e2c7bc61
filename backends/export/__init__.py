"""Write model files that an engine loads without this package, and a summary of the robot."""
