"""Runs of which nobody keeps the frames: for what is asked of them alone."""

from typing import Any, Final

from particlerb.compiled.threads import THREADS
from particlerb.simulation.outcome import Outcome
from particlerb.simulation.run import advance
from particlerb.simulation.whole_run import Prepared


class _Nowhere:
    """Takes frames in place of a recorder, and forgets them."""

    file: Final = None

    def append(self, frames: Any) -> None:
        """Forget frames."""

    def save_checkpoint(self, state: Any) -> None:
        """Forget a checkpoint."""

    def commit_if_due(self, state: Any) -> None:
        """Do nothing."""

    def finish(self) -> None:
        """Do nothing."""


def run_unrecorded(prepared: Prepared) -> Outcome:
    """Run a prepared system for its drift and its probes alone; raises as `run_prepared`."""
    with THREADS.using(prepared.system.run.threads):
        return advance(prepared, _Nowhere(), None, lambda reached: None)
