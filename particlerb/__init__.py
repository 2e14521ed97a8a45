"""Many rigid bodies built from mass particles: closed-form free motion, Numba kernels, HDF5.

`run(case)` integrates a case and returns its `Trajectory`; `open(path)` reads one back, and
`resume(path)` goes on with a run that was stopped or is to be prolonged. `Scene` is a case that is
put together in Python, from the tables of `particlerb.tables`; `Simulation` moves it by hand.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # (`X as X` tells type checkers that X is public)
    from particlerb import tables as tables
    from particlerb.case.problems import CaseError as CaseError
    from particlerb.case.scene import Scene as Scene
    from particlerb.case.schema import Case as Case
    from particlerb.record.provenance import show_versions as show_versions
    from particlerb.record.trajectory import Trajectory as Trajectory
    from particlerb.record.trajectory import TrajectoryError as TrajectoryError
    from particlerb.record.trajectory import open_trajectory
    from particlerb.simulation.entry import resume as resume
    from particlerb.simulation.entry import run as run
    from particlerb.simulation.joint_loads import joint_loads as joint_loads
    from particlerb.simulation.resume import ResumeError as ResumeError
    from particlerb.simulation.simulation import Simulation as Simulation
    from particlerb.simulation.whole_run import RunError as RunError
    from particlerb.studies.charts.trajectory import plot as plot
    from particlerb.sweeping.driver import sweep as sweep
    from particlerb.user_force import force as force

    System = Scene
    open = open_trajectory

__version__ = "0.1.0"
_HOMES = {
    "Case": "case.schema",
    "CaseError": "case.problems",
    "ResumeError": "simulation.resume",
    "RunError": "simulation.whole_run",
    "Scene": "case.scene",
    "Simulation": "simulation.simulation",
    "System": "case.scene",
    "Trajectory": "record.trajectory",
    "TrajectoryError": "record.trajectory",
    "force": "user_force",
    "joint_loads": "simulation.joint_loads",
    "open": "record.trajectory",
    "plot": "studies.charts.trajectory",
    "resume": "simulation.entry",
    "run": "simulation.entry",
    "show_versions": "record.provenance",
    "sweep": "sweeping.driver",
}
__all__ = ["__version__", *_HOMES]  # noqa: PLE0604  # names all of them


def __getattr__(name: str) -> Any:
    """Import public names when they are first used: Numba and HDF5 take a second to load."""
    if name == "tables":
        return import_module("particlerb.tables")
    if name not in _HOMES:
        raise AttributeError(f"module 'particlerb' has no attribute {name!r}")
    attribute = {"open": "open_trajectory", "System": "Scene"}.get(name, name)
    return getattr(import_module(f"particlerb.{_HOMES[name]}"), attribute)


def __dir__() -> list[str]:
    """Public names, for completion: most are not imported yet."""
    return [*__all__, "tables"]
