"""Put the repository in reach of the tests: `benchmarks` is no installed package."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))
