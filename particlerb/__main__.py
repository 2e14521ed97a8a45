"""`python -m particlerb`."""

import sys

from particlerb.cli import main

sys.exit(main())
