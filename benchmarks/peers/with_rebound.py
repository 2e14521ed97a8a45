"""REBOUND's Bulirsch-Stoer integrator on a user-defined equation; points that attract each other.

The equations and the variant `world` are those of `with_scipy`, all bodies in one state vector and
the centres of mass on their parabolas. REBOUND takes the right-hand side as a C function, so a
Numba-compiled one is called by address and Python is not entered in the loop.

Traps: the binding's `ode.derivatives` wraps Python functions only; a compiled one goes into the
private field beneath. The function gets no constants: it finds them in a table at a fixed address.
Accepted steps exchange `ode.y` with a work array: an array made of it before a run goes stale.
"""

import ctypes
from functools import cache

import numpy as np

from particlerb.compiled.threads import THREADS

from .scene import Result, Scene, absent, result
from .with_scipy import gathered, momenta_can_turn, rotation_problem

NAME = "REBOUND"
ADAPTIVE = True
TOLERANCES = tuple(10.0**-k for k in range(2, 14))
VARIANTS = {"BS": TOLERANCES, "BS world": TOLERANCES}
ATTRACTION = {"IAS15": TOLERANCES, "BS": TOLERANCES}
HOLDS = ("attraction",)

table = np.zeros(6, np.uintp)  # length of the state, bodies, bodies with G, and three addresses


def missing() -> str | None:
    """Why REBOUND cannot be used here."""
    return absent("rebound", "numba")


def refusal(scene: Scene) -> str | None:
    """Why these equations cannot hold the scene."""
    return momenta_can_turn(scene)


@cache
def compiled_callback(world: bool):
    """Function of (ode, rate, state, time) that writes the rate of all bodies' rotation."""
    from numba import carray, cfunc, types

    from .rotation import doubles_at, rotor_rates, world_rates

    rates = world_rates if world else rotor_rates
    address = table.ctypes.data
    doubles = types.CPointer(types.float64)

    @cfunc(types.void(types.voidptr, doubles, doubles, types.float64))
    def slope(ode, rate, state, time):
        # The table holds integers: they are read through a pointer to their own address.
        entries = carray(doubles_at(address), 6).view(np.uintp)
        length, n, loaded = entries[0], entries[1], entries[2]
        momenta = carray(doubles_at(entries[3]), (3, n))
        inverse = carray(doubles_at(entries[4]), (3, n))
        tensor = carray(doubles_at(entries[5]), (9, loaded))
        rates(carray(state, length), momenta, inverse, tensor, carray(rate, length))

    return slope


def run(scene: Scene, variant: str, step: float) -> Result:
    """Integrate the scene.

    Parameters
    ----------
    variant : str
        `BS`, or `BS world` with L in the world frame.
    step : float
        Tolerance, both relative and absolute, of quaternions and of momenta in units of their size.
    """
    import rebound
    from rebound.ode import ODEDER

    if scene.attraction is not None:
        return run_attraction(scene, variant, step)
    world = variant == "BS world"
    state, constants, unit = rotation_problem(scene, world)
    bodies, loaded = constants[0].shape[1], constants[2].shape[1]
    table[:] = len(state), bodies, loaded, *(a.ctypes.data for a in constants)
    slope = ctypes.cast(compiled_callback(world).address, ODEDER)

    def simulation():
        sim = rebound.Simulation()
        sim.integrator = "bs"
        sim.integrator.eps_rel = sim.integrator.eps_abs = step
        ode = sim.create_ode(length=len(state), needs_nbody=False)
        ode._derivatives = slope
        np.ctypeslib.as_array(ode.y, state.shape)[:] = state
        speed = np.linalg.norm(scene.angular_velocity, axis=1).max()
        sim.dt = min(scene.t_end, 1.0 / speed) if speed > 0 else 0.01 * scene.t_end
        return sim, ode

    sim, ode = simulation()
    sim.steps(1)
    sim, ode = simulation()
    started = THREADS.local.clock()
    sim.integrate(scene.t_end)
    seconds = THREADS.local.clock() - started
    state = np.ctypeslib.as_array(ode.y, state.shape).copy()
    return gathered(scene, seconds, state, constants, unit, world)


def run_attraction(scene: Scene, variant: str, step: float) -> Result:
    """Integrate points that attract each other, by IAS15 or Bulirsch-Stoer.

    For IAS15 the tolerance is its epsilon, the share of the last term in the acceleration.
    """
    import rebound

    sim = rebound.Simulation()
    sim.G, sim.softening = scene.attraction
    for m, x, v in zip(scene.mass, scene.position, scene.velocity, strict=True):
        sim.add(m=m, x=x[0], y=x[1], z=x[2], vx=v[0], vy=v[1], vz=v[2])
    sim.integrator = variant.lower()
    if variant == "IAS15":
        sim.integrator.epsilon = step
    else:
        sim.integrator.eps_rel = sim.integrator.eps_abs = step
    sim.dt = 1e-3 * scene.t_end
    started = THREADS.local.clock()
    sim.integrate(scene.t_end)
    seconds = THREADS.local.clock() - started
    position = np.array([p.xyz for p in sim.particles])
    velocity = np.array([p.vxyz for p in sim.particles])
    still = np.zeros_like(position)
    return result(scene, seconds, position, scene.orientation, velocity, still)
