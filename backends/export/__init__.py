"""Stock model files that an engine loads on its own, and a summary of a robot."""
