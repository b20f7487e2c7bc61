"""Draw pictures of a robot without a display."""
