"""SciPy's DOP853 and LSODA over all bodies in one state vector, with a Numba right-hand side.

The centres of mass move on parabolas under constant forces, so only the rotation is integrated: as
quaternion and angular momentum in the rotor frame, or, in the variants `world`, in the world frame
and then q alone where no torque acts (`rotation` says which is good for what). All bodies share
each adaptive step, which is what makes this a rival at high accuracy. DOP853 is stepped directly:
`solve_ivp` is the same loop, but keeps every step's state. LSODA goes through `odeint`, one call
in C for the whole run.

Traps: DOP853 sums its stages with a matrix product, which OpenBLAS spreads over threads for long
states and slows down threefold for 4000 bodies on two cores: install threadpoolctl, or start Python
with OPENBLAS_NUM_THREADS=1. LSODA reserves a dense Jacobian for its stiff method, 39 GB of
addresses for 10 000 bodies. A band of width one keeps that small; these equations are not stiff,
and were the method ever to switch, its error control would still hold with the poor Jacobian.
"""

from contextlib import AbstractContextManager, nullcontext
from types import ModuleType

import numpy as np

from particlerb.compiled.threads import THREADS

from .scene import Result, Scene, absent, loads, result, to_rotor, to_world

NAME = "SciPy"
ADAPTIVE = True
TOLERANCES = tuple(10.0**-k for k in range(2, 14))
VARIANTS = {"DOP853": TOLERANCES, "DOP853 world": TOLERANCES, "LSODA": TOLERANCES[1:-1]}
SPRINGS = {"DOP853": TOLERANCES}
HOLDS = ("springs",)


def missing() -> str | None:
    """Why SciPy cannot be used here."""
    return absent("scipy", "numba")


def refusal(scene: Scene) -> str | None:
    """Why these equations cannot hold the scene."""
    return momenta_can_turn(scene)


def momenta_can_turn(scene: Scene) -> str | None:
    """Why ω = I⁻¹ L, with no spin about an axis without moment, does not describe the scene."""
    tensor = loads(scene)[1]
    for body, moments in enumerate(scene.inertia):
        beside = np.ones(3, bool) if not moments.any() else (moments > 0) & (moments <= 0).any()
        if tensor[body][beside].any():
            return f"a push acts beside the particles of body {body}, which is a rod or a point"
    return None


def parabola(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities (n, 3) at `t_end` under gravity and the net pushes."""
    a = scene.gravity + loads(scene)[0] / scene.mass[:, None]
    t = scene.t_end
    return scene.position + t * (scene.velocity + 0.5 * t * a), scene.velocity + t * a


def rotation_problem(
    scene: Scene, world: bool
) -> tuple[np.ndarray, tuple[np.ndarray, ...], np.ndarray]:
    """State at the start, the constants of its rates, and the unit of each body's momentum.

    Every momentum is measured in a unit of its own size, so that one tolerance serves all
    components.

    Parameters
    ----------
    world : bool
        Prepare for `rotation.world_rates`, otherwise for `rotation.rotor_rates`.

    Returns
    -------
    state : ndarray, shape (7 n,) or (4 n,)
        q and the momenta, component first; q alone in the world frame where no torque acts.
    constants : tuple of ndarray
        Momenta (3, n), inverse moments (3, n), G (9, n) or (9, 0).
    unit : ndarray, shape (n,)
        The larger of |L| and (|G| I_max)^½ [kg m²/s].
    """
    from .rotation import columns

    momenta = scene.inertia * to_rotor(scene.orientation, scene.angular_velocity)
    tensor = loads(scene)[1]
    inverse = np.divide(1.0, scene.inertia, out=np.zeros_like(momenta), where=scene.inertia > 0)
    unit = np.sqrt(np.linalg.norm(tensor, axis=(1, 2)) * scene.inertia.max(1))
    unit = np.maximum(unit, np.linalg.norm(momenta, axis=1))
    unit[unit == 0] = 1.0
    if world:
        momenta = to_world(scene.orientation, momenta)
    q, momenta = columns(scene.orientation), columns(momenta) / unit
    alone = world and not tensor.any()
    state = np.vstack([q] if alone else [q, momenta]).ravel()
    tensor = columns(tensor) / unit if tensor.any() else np.zeros((9, 0))
    return state, (momenta, columns(inverse) * unit, tensor), unit


def gathered(
    scene: Scene,
    seconds: float,
    state: np.ndarray,
    constants: tuple[np.ndarray, ...],
    unit: np.ndarray,
    world: bool,
) -> Result:
    """Result from the state at `t_end` and from what `rotation_problem` returned."""
    n = len(scene.mass)
    q = state[: 4 * n].reshape(4, n).T
    q = q / np.linalg.norm(q, axis=1, keepdims=True)
    momenta = state[4 * n :].reshape(3, n) if state.size > 4 * n else constants[0]
    L = (unit * momenta).T if world else to_world(q, (unit * momenta).T)
    position, velocity = parabola(scene)
    return result(scene, seconds, position, q, velocity, L)


def run(scene: Scene, variant: str, step: float) -> Result:
    """Integrate the scene.

    Parameters
    ----------
    variant : str
        `DOP853` or `LSODA`, or `DOP853 world` with L in the world frame.
    step : float
        Tolerance, both relative and absolute, of quaternions and of momenta in units of their size.
    """
    from scipy import integrate

    from .rotation import rotor_rates, world_rates

    if scene.springs is not None:
        return run_springs(scene, step)
    method, _, world = variant.partition(" ")
    rates = world_rates if world else rotor_rates
    state, constants, unit = rotation_problem(scene, bool(world))

    def slope(t, y):
        rate = np.empty_like(y)
        rates(y, *constants, rate)
        return rate

    slope(0.0, state)
    with one_thread():
        started = THREADS.local.clock()
        state = SOLVERS[method](integrate, slope, state, scene.t_end, step)
        seconds = THREADS.local.clock() - started
    return gathered(scene, seconds, state, constants, unit, bool(world))


def run_springs(scene: Scene, step: float) -> Result:
    """Integrate all of the motion by DOP853: springs couple places and orientations."""
    from scipy import integrate

    from .springs import spring_problem, spring_rates

    state, constants, size = spring_problem(scene)

    def slope(t, y):
        rate = np.empty_like(state)
        spring_rates(size * y.reshape(state.shape), *constants, rate)
        return (rate / size).ravel()

    start = (state / size).ravel()
    slope(0.0, start)
    with one_thread():
        started = THREADS.local.clock()
        end = dop853(integrate, slope, start, scene.t_end, step)
        seconds = THREADS.local.clock() - started
    end = size * end.reshape(state.shape)
    q = end[6:10].T / np.linalg.norm(end[6:10].T, axis=1, keepdims=True)
    return result(scene, seconds, end[:3].T, q, end[3:6].T, to_world(q, end[10:].T))


def one_thread() -> AbstractContextManager:
    """Hold linear algebra to one thread where threadpoolctl is installed to do it."""
    if absent("threadpoolctl"):
        return nullcontext()
    from threadpoolctl import threadpool_limits

    return threadpool_limits(1)


def dop853(integrate: ModuleType, slope, state, t_end: float, tolerance: float):
    """State at `t_end` by Dormand and Prince's method of order 8."""
    solver = integrate.DOP853(slope, 0.0, state, t_end, rtol=tolerance, atol=tolerance)
    while solver.status == "running":
        solver.step()
    if solver.status != "finished":
        raise RuntimeError(f"DOP853 failed at t = {solver.t} s")
    return solver.y


def lsoda(integrate: ModuleType, slope, state, t_end: float, tolerance: float):
    """State at `t_end` by Adams methods of variable order."""
    ys, info = integrate.odeint(
        slope,
        state,
        [0.0, t_end],
        rtol=tolerance,
        atol=tolerance,
        ml=0,
        mu=0,
        mxstep=10**9,
        tfirst=True,
        full_output=True,
    )
    if info["message"] != "Integration successful.":
        raise RuntimeError(f"LSODA: {info['message']}")
    return ys[-1]


SOLVERS = {"DOP853": dop853, "LSODA": lsoda}
