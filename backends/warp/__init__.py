"""MuJoCo Warp: many copies at once on a GPU, in single precision; also on a CPU, slowly."""

import warp as _warp

# Else each of a hundred modules tells that it was loaded, and a machine without GPU is warned.
_warp.config.log_level = _warp.LOG_ERROR
