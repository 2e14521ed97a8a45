"""Many rigid bodies built from mass particles: closed-form free motion, Numba kernels, HDF5.

`run(case)` integrates a case and returns its `Trajectory`; `open(path)` reads one back, and
`resume(path)` goes on with a run that was stopped or is to be prolonged. `Scene` is a case that is
put together in Python, from the tables of `particlerb.tables`; `Simulation` moves it by hand.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from particlerb.case.problems import CaseError
    from particlerb.case.scene import Scene
    from particlerb.case.schema import Case
    from particlerb.record.provenance import show_versions
    from particlerb.record.trajectory import Trajectory, TrajectoryError
    from particlerb.record.trajectory import open_trajectory as open
    from particlerb.simulation.entry import resume, run
    from particlerb.simulation.resume import ResumeError
    from particlerb.simulation.simulation import Simulation
    from particlerb.simulation.whole_run import RunError
    from particlerb.studies.charts.trajectory import plot
    from particlerb.sweeping.driver import sweep
    from particlerb.user_force import force

__version__ = "0.1.0"
__all__ = [
    "Case",
    "CaseError",
    "ResumeError",
    "RunError",
    "Scene",
    "Simulation",
    "Trajectory",
    "TrajectoryError",
    "__version__",
    "force",
    "joint_loads",
    "open",
    "plot",
    "resume",
    "run",
    "show_versions",
    "sweep",
]

HOMES = {
    "Case": ("particlerb.case.schema", "Case"),
    "CaseError": ("particlerb.case.problems", "CaseError"),
    "ResumeError": ("particlerb.simulation.resume", "ResumeError"),
    "RunError": ("particlerb.simulation.run", "RunError"),
    "Scene": ("particlerb.case.scene", "Scene"),
    "Simulation": ("particlerb.simulation.simulation", "Simulation"),
    "Trajectory": ("particlerb.record.trajectory", "Trajectory"),
    "TrajectoryError": ("particlerb.record.trajectory", "TrajectoryError"),
    "force": ("particlerb.user_force", "force"),
    "joint_loads": ("particlerb.simulation.joint_loads", "joint_loads"),
    "open": ("particlerb.record.trajectory", "open_trajectory"),
    "plot": ("particlerb.studies.charts.trajectory", "plot"),
    "resume": ("particlerb.simulation.entry", "resume"),
    "run": ("particlerb.simulation.entry", "run"),
    "show_versions": ("particlerb.record.provenance", "show_versions"),
    "sweep": ("particlerb.sweeping.driver", "sweep"),
}


def __getattr__(name: str) -> Any:
    """Import public names when they are first used: Numba and HDF5 take a second to load."""
    if name not in HOMES:
        raise AttributeError(f"module 'particlerb' has no attribute {name!r}")
    module, attribute = HOMES[name]
    return getattr(import_module(module), attribute)
