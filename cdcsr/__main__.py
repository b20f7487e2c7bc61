"""`python -m cdcsr`: the same as the command `cdcsr`."""

import sys

from cdcsr.cli import main

sys.exit(main())
