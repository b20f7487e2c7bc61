"""The robot: its description, the paths of its cables, its meshes."""
