"""MuJoCo: cables are spatial tendons with a length limit."""
