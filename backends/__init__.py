"""The engines, each in a folder of its own, and what only concerns engines."""
