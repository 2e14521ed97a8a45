"""LAMMPS, where it is installed, to read what was written for it."""

import sys
from pathlib import Path

import pytest


@pytest.fixture
def lammps():
    """A LAMMPS that takes commands."""
    sys.path.insert(0, str(Path(__file__).parents[2]))
    try:
        from benchmarks.peers.with_lammps import missing, start
    finally:
        sys.path.pop(0)
    if missing():
        pytest.skip(missing())
    engine = start()
    yield engine
    engine.close()
