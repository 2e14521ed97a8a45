"""Serves the sessions of `crashes.py` with superblocks of 256 bodies, and one rank without MPI."""

import sys
from pathlib import Path

from small_superblocks import commit_often

sys.path.insert(0, str(Path(__file__).parents[1] / "record"))

if __name__ == "__main__":
    from crashes import serve

    from particlerb.cli import ranks
    from particlerb.ranks import Ranks

    commit_often()
    ranks.ranks_of_mpi = Ranks
    serve(*sys.argv[2:4])
