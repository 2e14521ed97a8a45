"""The commands, with superblocks of one block of 256 bodies: small scenes have several.

Particles that attract each other come in tiles of 8.

OFTEN=1: a commit with a checkpoint behind every frame. LIMITED=N: on rank 1 no file may grow above
N bytes, which is there as if the disk were full, and rank 0 leaves its files last. MARK=...: for
who looks for these processes.
"""

import os
import time

from particlerb.forces import attraction
from particlerb.model import superblocks
from particlerb.ranks import Ranks

superblocks.SUPERBLOCK = 256
attraction.TILE = 8


def commit_often() -> None:
    """Commit behind every frame."""
    from particlerb.record import part_recorder
    from particlerb.simulation import frame_times

    frame_times.BATCH_FRAMES = 1
    part_recorder.SECONDS_BETWEEN_COMMITS = -1.0
    part_recorder.SHARE_OF_CHECKPOINTS = 1e9


def limit_second_rank() -> None:
    """Let no file of rank 1 grow above a size; MPI makes its own before."""
    import resource

    limit = int(os.environ["LIMITED"])

    from particlerb.cli import ranks as of_commands
    from particlerb.record.output_file import OutputFile

    started, abandon = of_commands.ranks_of_mpi, OutputFile.abandon

    def abandon_late(self: OutputFile) -> None:
        time.sleep(0.3)
        abandon(self)

    def started_and_limited() -> Ranks:
        found = started()
        if found.number == 1:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
        else:
            OutputFile.abandon = abandon_late
        return found

    of_commands.ranks_of_mpi = started_and_limited


if __name__ == "__main__":
    from particlerb.cli import entry

    if os.environ.get("OFTEN"):
        commit_often()
    if os.environ.get("LIMITED"):
        limit_second_rank()
    entry()
