"""`python -m host` is the console script `host`."""

import sys

from .cli import main

sys.exit(main())
