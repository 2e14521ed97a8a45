"""Centres of mass of a block, by whatever moves them in closed form."""

from typing import Any

from particlerb.compiled.jit import inline
from particlerb.maths.vec3 import Floats
from particlerb.stepping.damped_oscillators import DampedOscillator, braked
from particlerb.stepping.orbits import Orbit, orbited
from particlerb.stepping.translations import (
    Centres,
    Damping,
    Oscillator,
    add_drift,
    damped,
    parabola,
    sprung,
)


@inline
def translate(
    drag: Damping | None, spring: Oscillator | None, brake: DampedOscillator | None,
    drift: Floats | None, orbit: Orbit | None, of: Centres, lo: int, t: float, external: Any,
) -> None:  # fmt: skip
    """Centres of mass; Numba leaves out what is None."""
    if drag is not None:
        damped(of, drag, lo, t, external)
    if spring is not None:
        sprung(of, spring, lo, t, external)
    if brake is not None:
        braked(of, brake, lo, t, external)
    if drift is not None:
        add_drift(of, drift, lo, t)
    if orbit is not None:
        orbited(of, orbit, lo, t, external)
    if drag is None and spring is None and brake is None and orbit is None:
        parabola(of, t)
