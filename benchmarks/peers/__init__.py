"""Other engines on the same bodies, for the work-precision charts: final state and wall time.

Every engine is a module with the same names: `NAME`, `VARIANTS` (variant -> ladder), `ADAPTIVE`,
`missing()`, `refusal(scene)` and `run(scene, variant, step)`. Where `ADAPTIVE` is false the ladder
holds h·ω_max, steps in units of the inverse of the largest angular speed, and `run` takes the step
h in seconds; where it is true both are tolerances. `HOLDS` names what more an engine takes, of
joints, springs and attraction; `SPRINGS` and `ATTRACTION` are its ladders there. `ENGINES[name]()`
imports a module when it is asked for, so that a machine without the engine can still list it.
"""

from functools import partial
from importlib import import_module

ENGINES = {
    name: partial(import_module, f"{__name__}.with_{name}")
    for name in ("mujoco", "lammps", "pybullet", "scipy", "rebound", "textbook")
}
