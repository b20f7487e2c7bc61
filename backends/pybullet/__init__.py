"""PyBullet: the robot as URDF, its cables as a complementarity problem solved at every step."""

import os

# PyBullet greets every process that imports it, below Python's reach, with its build time. An error in the
# import is an exception and gets through.
_stderr, _nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
os.dup2(_nowhere, 2)
try:
    import pybullet as pybullet
finally:
    os.dup2(_stderr, 2)
    os.close(_stderr)
    os.close(_nowhere)
