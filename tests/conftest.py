"""One thread for matrix products in each test process: more of them only get in each other's way."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
