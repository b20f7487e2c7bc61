"""The PyBullet engine; :mod:`backends.pybullet.simulation` says what Bullet computes in it."""

import os

# PyBullet prints its build time to the file descriptor of standard error when it is imported. An
# error in the import is an exception and is still seen.
_stderr, _nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
os.dup2(_nowhere, 2)
try:
    import pybullet as pybullet
finally:
    os.dup2(_stderr, 2)
    os.close(_stderr)
    os.close(_nowhere)
