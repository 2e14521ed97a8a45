"""Springs, fields and drag: their symmetries and potentials, closed forms, integrations.

Rounding of what is computed here in one place is some 1e-16 of the largest number on the way.
"""

import numpy as np
import pytest
from formulas import derivative
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ellipk

import particlerb
from particlerb.case.problems import CaseError
from particlerb.compiled.jit import kernel
from particlerb.forces import (
    Terms,
    acting_of,
    energies_of_loads,
    row_count,
    rows_of_terms,
    works_of,
)
from particlerb.forces.central import Central
from particlerb.forces.drag import Drag
from particlerb.forces.kernels import load_at
from particlerb.forces.push import Follower, Push
from particlerb.forces.spring import Spring
from particlerb.forces.torque import Torque
from particlerb.maths.quaternion import matrix
from particlerb.model.block import in_blocks, state_rows
from particlerb.model.bodies import Bodies
from particlerb.model.state import State

INERTIA = np.array([1.0, 2.0, 2.5])
MASS = 2.0
START = {
    "position": [1.0, 0.2, 0.3],
    "velocity": [0.3, 0.1, -0.2],
    "orientation": [0.8, 0.0, 0.6, 0.0],
    "angular_velocity": [1.0, 0.4, -0.7],
}
seeds = st.integers(0, 2**32 - 1)


@kernel
def load_of_first(acting, rows, x, q, p, L):
    return load_at(acting, rows, 0, x, matrix(q), p, L)


def column(v):
    return np.asarray(v, dtype=float).reshape(-1, 1)


def loads(terms, x, q, p=(0.0, 0.0, 0.0), L=(0.0, 0.0, 0.0)):
    """Force, torque, and the part of both that has a potential, of one body in the world frame."""
    inertia = column(INERTIA)
    bodies = Bodies(
        np.full(1, MASS), np.full(1, 1 / MASS), inertia, 1 / inertia, column([1, 0, 0, 0]),
        np.full(1, 4),
    )  # fmt: skip
    state = State(*(column(v) for v in (x, q, p, L)))
    parts = state_rows(state, bodies) + rows_of_terms(terms)
    rows = in_blocks(1, row_count(terms), parts)[0]
    as_floats = (tuple(float(c) for c in v) for v in (x, q, p, L))
    return tuple(np.array(v) for v in load_of_first(acting_of(terms), rows, *as_floats))


def world(seed):
    """Two of each kind of field, at random; a place, an orientation and momenta beside them."""
    rng = np.random.default_rng(seed)
    v = rng.standard_normal

    def spring():
        return Spring(v((3, 1)), 2.0 * v((3, 1)), rng.uniform(0.1, 3, 1), rng.uniform(0, 2, 1))

    def centre():
        far = 6.0 * column(unit(v(3)))
        return Central(far, rng.uniform(0.1, 9, 1), np.full(1, MASS), column(INERTIA))

    terms = Terms(
        loads=(
            Push(v((3, 1)), v((9, 1))),
            Follower(v((3, 1)), v((3, 1))),
            Torque(v((3, 1))),
            Drag(rng.uniform(0, 2, 1), rng.uniform(0, 2, 1)),
            spring(),
            spring(),
            centre(),
            centre(),
        )
    )
    return terms, (v(3), unit(v(4)), v(3), v(3))


def unit(v):
    return v / np.linalg.norm(v)


KINDS = {
    "push": Push,
    "follower": Follower,
    "torque": Torque,
    "drag": Drag,
    "spring": Spring,
    "central": Central,
}
SIZES = {Spring: ["stiffness"], Central: ["mu"]}  # what makes them zero; of others all


def of(terms, name):
    """The loads of a kind."""
    return [load for load in terms.loads if isinstance(load, KINDS[name])]


def only(terms, name, one=None):
    """The same terms with all sizes zero but those of one, so that the compiled code is the same.

    `one` picks a single one of two springs or centres.
    """
    kept = [load for k, load in enumerate(of(terms, name)) if one in (None, k)]

    def none(load):
        sizes = SIZES.get(type(load), load._fields)
        return load._replace(**{size: 0.0 * getattr(load, size) for size in sizes})

    chosen = (load if any(load is k for k in kept) else none(load) for load in terms.loads)
    return Terms(loads=tuple(chosen))


def changed(terms, **changes):
    """The same terms with the loads of some kinds made anew."""
    by_type = {KINDS[name]: change for name, change in changes.items()}
    made = (by_type.get(type(load), lambda same: same)(load) for load in terms.loads)
    return terms._replace(loads=tuple(made))


# Symmetries and potentials


def turned_world(terms, R):
    """The same scene, turned as a whole: what is fixed in the body stays as it is."""

    def world(v):
        return column(R.apply(v[:, 0]))

    def push(push):
        T = R.as_matrix() @ push.lever.reshape(3, 3)  # row j of T is the force's component j
        return Push(world(push.force), T.reshape(9, 1))

    return changed(
        terms,
        push=push,
        torque=lambda torque: Torque(world(torque.torque)),
        spring=lambda s: s._replace(anchor=world(s.anchor)),
        central=lambda c: c._replace(centre=world(c.centre)),
    )


@given(seed=seeds, turn=seeds, kind=st.sampled_from(list(KINDS)))
@settings(max_examples=60)
def test_a_scene_turned_as_a_whole_has_turned_forces(make, seed, turn, kind):
    terms, (x, q, p, L) = world(seed)
    terms = only(terms, kind)
    R = make.rotation(unit(np.random.default_rng(turn).standard_normal(4)))
    new_q = (R * make.rotation(q)).as_quat(scalar_first=True)
    turned = loads(turned_world(terms, R), R.apply(x), new_q, R.apply(p), R.apply(L))
    for one, other in zip(loads(terms, x, q, p, L), turned, strict=True):
        assert other == pytest.approx(R.apply(one), abs=1e-13)


@given(seed=seeds, shift=seeds, kind=st.sampled_from(list(KINDS)))
@settings(max_examples=60)
def test_a_scene_moved_as_a_whole_has_the_same_forces(seed, shift, kind):
    terms, (x, q, p, L) = world(seed)
    terms, by = only(terms, kind), np.random.default_rng(shift).standard_normal(3)
    moved = changed(
        terms,
        spring=lambda s: s._replace(anchor=s.anchor + column(by)),
        central=lambda c: c._replace(centre=c.centre + column(by)),
    )
    for one, other in zip(loads(terms, x, q, p, L), loads(moved, x + by, q, p, L), strict=True):
        assert other == pytest.approx(one, abs=1e-13)


def potential_work(terms, com, q):
    """Work of all forces with a potential, up to a constant [J]."""
    energies = energies_of_loads(terms, com, q, 1)
    return np.sum(works_of(terms, com, q, np.zeros(1))) - np.sum(energies)


@given(seed=seeds, kind=st.sampled_from(list(KINDS)))
@settings(max_examples=60)
def test_forces_with_a_potential_are_its_gradient_and_the_others_are_counted(make, seed, kind):
    """F = ∂W/∂x and τ·e = dW/dφ for a turn by φ about the world axis e, W the work done."""
    terms, (x, q, p, L) = world(seed)
    terms = only(terms, kind)
    F, tau, own_force, own_torque = loads(terms, x, q, p, L)
    if kind in ("push", "spring", "central"):
        assert (own_force == F).all()
        assert (tau == own_torque).all()
    else:
        assert not own_force.any()
        assert not own_torque.any()
    R = make.rotation(q)
    for axis, f, t in zip(np.eye(3), own_force, own_torque, strict=True):

        def joint_data_at(s, axis=axis):
            return potential_work(terms, column(x + s * axis), column(q))

        def work_turned(s, axis=axis):
            turn = (R.from_rotvec(s * axis) * R).as_quat(scalar_first=True)
            return potential_work(terms, column(x), column(turn))

        assert derivative(joint_data_at) == pytest.approx(f, abs=1e-8 * (1 + abs(f)))
        assert derivative(work_turned) == pytest.approx(t, abs=1e-8 * (1 + abs(t)))


@given(seed=seeds)
@settings(max_examples=40)
def test_terms_and_several_of_a_kind_add_up(seed):
    terms, state = world(seed)
    whole = loads(terms, *state)
    parts = [only(terms, kind) for kind in list(KINDS)[:4]]
    parts += [only(terms, kind, k) for kind in ("spring", "central") for k in (0, 1)]
    summed = np.sum([loads(part, *state) for part in parts], axis=0)
    assert np.array(whole) == pytest.approx(summed, abs=1e-13)


@given(seed=seeds)
@settings(max_examples=40)
def test_drag_takes_power_and_acts_against_the_motion(make, seed):
    """F·v + τ·ω = -c v² - c_r ω²."""
    terms, (x, q, p, L) = world(seed)
    F, tau, _, _ = loads(only(terms, "drag"), x, q, p, L)
    v, R = p / MASS, make.rotation(q).as_matrix()
    w = R @ (R.T @ L / INERTIA)
    (drag,) = of(terms, "drag")
    c, c_r = MASS * drag.rate[0], drag.rotation[0]
    assert pytest.approx(-c * v, abs=1e-14) == F
    assert tau == pytest.approx(-c_r * w, abs=1e-14)
    assert F @ v + tau @ w <= 0.0


@given(seed=seeds)
@settings(max_examples=40)
def test_a_central_field_turns_nothing_about_its_centre(seed):
    """(x - c) × F + τ = 0: what the gradient gives a body it takes from the orbit."""
    terms, (x, q, p, L) = world(seed)
    F, tau, _, _ = loads(only(terms, "central", 0), x, q, p, L)
    arm = x - of(terms, "central")[0].centre[:, 0]
    assert np.linalg.norm(tau) > 0
    assert np.cross(arm, F) + tau == pytest.approx(np.zeros(3), abs=1e-14)


def test_a_spring_of_no_length_and_one_at_its_rest_length_give_nothing():
    q, at = np.array([1.0, 0, 0, 0]), column([0.1, 0.2, 0.3])
    for anchor, rest in (([0.1, 0.2, 0.3], 0.0), ([0.1, 0.2, 0.3], 2.0), ([0.1, 0.2, 2.3], 2.0)):
        terms = Terms(loads=(Spring(at, column(anchor), np.ones(1), np.full(1, rest)),))
        for value in loads(terms, np.zeros(3), q):
            assert value == pytest.approx(np.zeros(3), abs=1e-15)


@pytest.mark.parametrize(("is_even", "order"), [(False, 3), (True, 4)])
def test_a_central_field_is_the_sum_over_the_particles_of_a_small_body(make, is_even, order):
    """-μ m r/|r|³ for each of 20 particles; the series is cut after (size/distance)².

    What is left out is of third order, and of fourth for a cloud that is its own mirror image.
    """
    rng = np.random.default_rng(5)
    r, m = rng.standard_normal((10, 3)), rng.uniform(0.5, 2.0, 10)
    if is_even:
        r, m = np.vstack([r, -r]), np.concatenate([m, m])
    r -= m @ r / m.sum()
    tensor = np.einsum("i,ij,ij->", m, r, r) * np.eye(3) - np.einsum("i,ij,ik", m, r, r)
    moments, axes = np.linalg.eigh(tensor)
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    q = make.rotation([1.0, 0, 0, 0]).from_matrix(axes).as_quat(scalar_first=True)
    x, mu = np.array([2.0, -1.0, 2.0]), 3.0
    sizes, errors = 0.2 / 2.0 ** np.arange(5), []
    for size in sizes:
        centre = Central(np.zeros((3, 1)), np.full(1, mu), column(m.sum()), column(moments))
        centre = centre._replace(mass=centre.mass[0], inertia=centre.inertia * size**2)
        F, tau, _, _ = loads(Terms(loads=(centre,)), x, q)
        far = x + size * r
        each = -mu * m[:, None] * far / np.linalg.norm(far, axis=1)[:, None] ** 3
        turning = np.cross(size * r, each).sum(axis=0)
        wrong = np.linalg.norm(F - each.sum(axis=0)), np.linalg.norm(tau - turning)
        assert wrong[1] < 0.5 * np.linalg.norm(turning)
        errors.append(wrong)
    slopes = np.log2(np.array(errors[-3:-1]) / errors[-2:])
    assert slopes == pytest.approx(order, abs=0.1)


# Motion, against an integration that shares nothing with the program


def check_motion(make, found, true, limit, body=0):
    """Every quantity, and the work of all forces, at every frame."""
    assert make.angle(found.orientation[:, body], true.orientation).max() < limit
    for name in ("position", "velocity", "angular_momentum", "angular_velocity"):
        expected = getattr(true, name)
        assert getattr(found, name)[:, body] == pytest.approx(expected, abs=limit)


SPRINGS = {
    "at the centre of mass": {"rest_length": 0.0, "at": [0, 0, 0]},
    "with a rest length": {"rest_length": 0.7, "at": [0, 0, 0]},
    "off the centre of mass": {"rest_length": 0.7, "at": [0.4, -0.3, 0.2]},
    "that pushes": {"rest_length": 4.0, "at": [0.4, -0.3, 0.2]},
}


def test_springs_against_an_integration(make):
    """A group of bodies, each with a spring of its own."""
    rows = {key: [START[key]] * len(SPRINGS) for key in START}
    bodies = make.body(count=len(SPRINGS), **rows)
    forces = [
        make.spring([0.5, 1.0, 2.0 + k], 3.0 + k, body=f"body[{k}]", **keys)
        for k, keys in enumerate(SPRINGS.values())
    ]
    scene = make.case(bodies, force=forces, t_end=1.6, every=0.4, method="dop853", tolerance=1e-13)
    found, work = make.arrays(scene), 0.0
    for k, force in enumerate(forces):
        true = make.integrate(np.diag(INERTIA), MASS, START, [force], found.time)
        # a few dozen steps, each with an error of 1e-13 of what it moves
        check_motion(make, found, true, 1e-11, k)
        work = work + true.external[:, 0]
    assert make.done(found.ledger) == pytest.approx(work, abs=1e-10)
    assert not found.ledger.work.any()


def test_drag_in_a_central_field_against_an_integration(make):
    """Of an asymmetric body: the momentum along each axis decays at a rate of its own."""
    forces = [make.central(5.0, [4.0, 0, 0]), make.drag(0.3, 0.2), make.drag(0.1, 0.0)]
    keys = {"force": forces, "t_end": 1.6, "every": 0.4}
    found = make.arrays(make.case(make.body(**START), method="dop853", tolerance=1e-13, **keys))
    true = make.integrate(np.diag(INERTIA), MASS, START, forces, found.time)
    check_motion(make, found, true, 1e-11)
    assert found.ledger.work == pytest.approx(true.external[:, 0], abs=1e-10)


@pytest.mark.compiled
@pytest.mark.parametrize("drag", [[], [("drag", 0.3, 0.2)]])
def test_all_forces_together_against_an_integration(make, drag):
    forces = fields(make) + [make.drag(*numbers) for _, *numbers in drag]
    if drag:
        forces += [make.torque([0.1, 0.2, 0.3]), make.push([1, 0, 0], [0, 0.1, 0], frame="body")]
    method = "dop853" if drag else "rkn6"
    keys = {"dt": 0.02, "method": method, "tolerance": 1e-13}
    scene = make.case(make.body(**START), force=forces, t_end=1.6, every=0.4, **keys)
    found = make.arrays(scene)
    true = make.integrate(np.diag(INERTIA), MASS, START, forces, found.time)
    check_motion(make, found, true, 1e-11)
    assert make.done(found.ledger) == pytest.approx(true.external[:, 0], abs=1e-10)


def fields(make):
    """A push, two springs and a centre."""
    return [
        make.push([1.0, 2.0, -1.5], [0.4, -0.3, 0.2]),
        make.spring([0, 0, 2.0], 2.0, 0.5, [0.1, 0.2, 0.3]),
        make.spring([1, 1, 1.0], 2.0, 0.0, [0.1, 0.2, 0.3]),
        make.central(3.0, [5.0, 0, 0]),
    ]


# Closed forms


def test_drag_slows_down_and_lets_fall_at_the_terminal_velocity(make):
    """v = g M/c + (v₀ - g M/c) e^{-ct/M}, ω = ω₀ e^{-c_r t/I}: a kick of `strang` is this flow.

    The spin is exact whatever the step; so is the velocity, since a drift does not change it.
    """
    c, c_r, moment, g = 0.8, 0.3, 1.7, np.array([0, 0, -9.81])
    w0, v0 = np.array([0.3, -0.2, 0.5]), np.array([3.0, -1.0, 2.0])
    start = {"velocity": v0, "angular_velocity": w0}
    body = make.body(inertia=[moment] * 3, **start)
    keys = {"gravity": {"acceleration": g}, "force": [make.drag(c, c_r)], "t_end": 30.0}
    found = make.arrays(make.case(body, every=3.0, dt=0.25, **keys))
    t = found.time[:, None]
    last = MASS * g / c
    # 240 steps, each with a rounding of 1e-16 of 24 m/s
    decayed = last + (v0 - last) * np.exp(-c * t / MASS)
    assert found.velocity[:, 0] == pytest.approx(decayed, abs=1e-12)
    assert found.angular_velocity[:, 0] == pytest.approx(w0 * np.exp(-c_r * t / moment), abs=1e-14)
    assert found.velocity[-1, 0] == pytest.approx(last, abs=28 * np.exp(-12.0))
    # the centre of mass moves by the velocity after each half kick: order 2
    way = last * t + (v0 - last) * (1 - np.exp(-c * t / MASS)) * MASS / c
    assert found.position[:, 0] == pytest.approx(way, abs=(c / MASS * 0.25) ** 2 / 12 * 27 * 2.5)
    # kinetic energy less what drag took, against the loss of height, where the way's error shows
    assert np.abs(found.ledger.linear_momentum_error).max() < 1e-12


def test_a_spin_about_each_principal_axis_decays_at_a_rate_of_its_own(make):
    """ω_k = ω₀ e^{-c_r t/I_k}, whatever the order of the axes in the rotor frame."""
    bodies = [
        make.body(f"about {k}", INERTIA, angular_velocity=0.5 * np.eye(3)[k]) for k in range(3)
    ]
    names = [body["name"] for body in bodies]
    keys = {"gravity": {"acceleration": [0, 0, -9.81]}, "force": [make.drag(0.1, 0.6, names)]}
    found = make.arrays(make.case(*bodies, **keys, t_end=4.0, every=0.5, dt=0.1))
    for k in range(3):
        spin = 0.5 * np.exp(-0.6 * found.time / INERTIA[k])
        assert found.angular_velocity[:, k, k] == pytest.approx(spin, abs=1e-14)


def test_a_point_has_no_spin_to_lose_and_a_rod_none_about_its_axis(make):
    """γ_k = c_r/I_k is left out where I_k = 0."""
    gravity = {"acceleration": [0, 0, -9.81]}
    bodies = [
        make.body("point", [0, 0, 0], velocity=[1.0, 0, 0]),
        make.body("rod", [1.3, 1.3, 0], velocity=[1.0, 0, 0], angular_velocity=[0.6, 0, 0]),
    ]
    force = [make.drag(0.5, 0.4, ["point", "rod"])]
    found = make.arrays(make.case(*bodies, force=force, t_end=2.0, dt=0.1, gravity=gravity))
    slower = np.exp(-0.5 / MASS * found.time)
    assert found.velocity[:, :, 0] == pytest.approx(np.tile(slower, (2, 1)).T, abs=1e-14)
    spin = 0.6 * np.exp(-0.4 / 1.3 * found.time)
    assert found.angular_velocity[:, 1, 0] == pytest.approx(spin, abs=1e-14)
    assert not found.angular_momentum[:, 0].any()


@pytest.mark.compiled
def test_an_orbit_closes_and_keeps_energy_and_momentum_about_the_centre(make):
    """A rod too small to matter on an ellipse: back after 2π √(a³/μ), a = 1/(2/r - v²/μ)."""
    mu, r, v = 4.0, 2.0, 1.2
    a = 1.0 / (2.0 / r - v * v / mu)
    period = 2 * np.pi * np.sqrt(a**3 / mu)
    start = {"position": [r, 0, 0], "velocity": [0, v, 0], "angular_velocity": [0.3, 0, 0]}
    rod = make.body(inertia=[1e-14, 1e-14, 0], **start)
    keys = {"method": "rkn6", "t_end": 3 * period, "every": period, "dt": period / 200}
    found = make.arrays(make.case(rod, force=[make.central(mu)], **keys))
    assert found.position[:, 0] == pytest.approx(np.tile(start["position"], (4, 1)), abs=1e-9)
    # two thirds of an orbit away it is elsewhere
    there = make.arrays(make.case(rod, force=[make.central(mu)], **keys | {"every": period / 3}))
    assert np.abs(there.position[1, 0] - [r, 0, 0]).max() > 0.1
    assert np.abs(there.ledger.energy_error).max() < 1e-9
    L = np.cross(there.position[:, 0], there.linear_momentum[:, 0])
    assert pytest.approx(np.tile(L[0], (10, 1)), abs=1e-13) == L


@pytest.mark.compiled
@pytest.mark.parametrize("tilt", [0.01, 0.6])
def test_a_dumbbell_on_a_circular_orbit_librates_like_a_pendulum(make, tilt):
    """In the plane of the orbit θ'' = -(3/2) n² sin 2θ: √3 n for small tilts, n = √(μ/d³)."""
    mu, d, moment = 1.0, 1.0, 1e-12
    n = np.sqrt(mu / d**3)
    period = 4 * ellipk(np.sin(tilt) ** 2) / (np.sqrt(3) * n)
    if tilt == 0.01:
        assert period == pytest.approx(2 * np.pi / np.sqrt(3 * mu / d**3), rel=3e-5)
    upright = make.rotation([1.0, 0, 0, 0]).from_euler("y", np.pi / 2)  # its axis is radial
    around = upright.from_rotvec([0, 0, tilt])
    start = {
        "position": [d, 0, 0],
        "velocity": [0, d * n, 0],
        "orientation": (around * upright).as_quat(scalar_first=True),
        "angular_velocity": [0, 0, n],
    }
    rod = make.body(inertia=[moment, moment, 0], **start)
    keys = {"method": "rkn6", "t_end": period, "every": period / 4, "dt": period / 100}
    found = make.arrays(make.case(rod, force=[make.central(mu)], **keys))
    axis = make.rotation(found.orientation[:, 0]).apply([0, 0, 1])
    up = found.position[:, 0] / np.linalg.norm(found.position[:, 0], axis=1)[:, None]
    theta = np.arcsin(np.cross(up, axis)[:, 2])
    # upright after a quarter, on the other side after half a period
    assert theta == pytest.approx([tilt, 0, -tilt, 0, tilt], abs=1e-9)


def test_energy_and_momentum_of_an_asymmetric_body_in_a_central_field_are_kept(make):
    """About the centre, orbit and spin together; with `strang` to rounding, for any step."""
    force = [make.central(5.0, [4.0, 0, 0])]
    keys = {"force": force, "t_end": 2.0, "every": 0.5, "dt": 0.05, "method": "strang"}
    found = make.arrays(make.case(make.body(**START), **keys))
    arm = found.position[:, 0] - [4.0, 0, 0]
    total = np.cross(arm, found.linear_momentum[:, 0]) + found.angular_momentum[:, 0]
    assert total == pytest.approx(np.tile(total[0], (5, 1)), abs=1e-12)
    spin = found.angular_momentum[:, 0]
    assert np.abs(spin - spin[0]).max() > 1e-3
    # order 2 at a spin of 1.3 rad/s: (0.05 · 1.3)² of a kinetic energy of 1.5 J
    assert 0 < np.abs(found.ledger.energy_error).max() < 6e-3


# Uniform fields


CORNERS = np.array([[x, y, z] for x in (-0.5, 0.4) for y in (-0.3, 0.6) for z in (-0.2, 0.7)])
CHARGES = [1.0, -2.0, 0.5, 3.0, -1.5, 0.2, 0.7, -0.4]


def charged(make, name="body", mass=None, **keys):
    """Eight particles that no axis is a symmetry of, from their centre of mass."""
    mass = np.array([0.1, 0.2, 0.3, 0.4, 0.1, 0.3, 0.2, 0.4]) if mass is None else mass
    r = CORNERS - mass @ CORNERS / mass.sum()
    shape = {"type": "points", "position": r, "mass": mass}
    return {"name": name, "shape": shape, **START, **keys}, r, mass


def test_charges_and_a_dipole_against_an_integration(make):
    """Of an asymmetric body: the field pulls at the charge, turns by it and by the dipole."""
    force = [make.field([0.3, -0.8, 1.2], 1.5, [0.2, 0.5, -0.4], at=[0.4, -0.3, 0.2])]
    keys = {"force": force, "t_end": 1.6, "every": 0.4}
    found = make.arrays(make.case(make.body(**START), method="dop853", tolerance=1e-13, **keys))
    true = make.integrate(np.diag(INERTIA), MASS, START, force, found.time)
    check_motion(make, found, true, 1e-11)
    assert found.ledger.work == pytest.approx(true.external[:, 0], abs=1e-11)
    assert np.abs(true.external[-1, 0]) > 0.1


@pytest.mark.parametrize("tilt", [0.01, 1.5])
def test_a_dipole_librates_like_a_pendulum(make, tilt):
    """θ'' = -(d E/I) sin θ: for small tilts ω² = d E/I, for others 4 K(sin² θ₀/2)/ω a period."""
    d, E, moment = 0.3, 5.0, 1.3
    omega = np.sqrt(d * E / moment)
    period = 4 * ellipk(np.sin(tilt / 2) ** 2) / omega
    if tilt == 0.01:
        assert period == pytest.approx(2 * np.pi * np.sqrt(moment / (d * E)), rel=1e-5)
    q = [np.cos(tilt / 2), np.sin(tilt / 2), 0, 0]
    rod = make.body(inertia=ROD, orientation=q)
    keys = {"t_end": period, "every": period / 4, "method": "dop853", "tolerance": 1e-13}
    found = make.arrays(make.case(rod, force=[make.field([0, 0, E], dipole=[0, 0, d])], **keys))
    axis = make.rotation(found.orientation[:, 0]).apply([0, 0, 1])
    theta = np.arctan2(-axis[:, 1], axis[:, 2])
    assert theta == pytest.approx([tilt, 0, -tilt, 0, tilt], abs=1e-10)
    assert not found.linear_momentum.any()


def test_a_charge_falls_in_a_field_as_a_mass_does_in_gravity(make):
    """a = q E/m: the same parabola, in closed form, to rounding."""
    q, E = 0.6, np.array([0.5, -3.0, 1.0])
    body = make.body(**START)
    in_field = make.arrays(make.case(body, force=[make.field(E, q)], t_end=2.0))
    falling = make.arrays(make.case(body, gravity={"acceleration": q * E / MASS}, t_end=2.0))
    assert "closed form" in in_field.plan.splitlines()[-1]
    for name in ("position", "velocity"):
        assert getattr(in_field, name) == pytest.approx(getattr(falling, name), abs=1e-14)
    assert (in_field.orientation == falling.orientation).all()
    way = np.array(START["velocity"]) * 2.0 + 0.5 * q * E / MASS * 4.0
    assert in_field.position[-1, 0] == pytest.approx(START["position"] + way, abs=1e-14)


def test_energy_in_a_field_is_kept_and_its_work_is_the_loss_of_potential_energy(make):
    """-Σ q_i E·x_i - d·E with every particle where it is."""
    E, d = np.array([0.4, 1.0, -0.7]), np.array([0.1, -0.3, 0.2])
    body, r, _ = charged(make)
    keys = {"force": [make.field(E, CHARGES, d)], "t_end": 2.0, "every": 0.25, "dt": 0.01}
    found = make.arrays(make.case(body, method="rkn6", **keys))
    R = make.rotation(found.orientation[:, 0])
    x = found.position[:, 0]
    fallen = sum(q * (x + R.apply(p)) @ E for q, p in zip(CHARGES, r, strict=True)) + R.apply(d) @ E
    assert found.ledger.work == pytest.approx(fallen - fallen[0], abs=1e-12)
    assert np.ptp(fallen) > 0.5
    assert np.abs(found.ledger.energy_error).max() < 1e-9


def test_charges_of_particles_are_one_charge_at_their_centre_or_at_the_mass_and_a_dipole(make):
    """Force and torque of charges know of Σ q and Σ q r only."""
    E, q = [0.4, 1.0, -0.7], np.array(CHARGES)
    names = ["each", "at their centre", "beside a dipole", "without charge"]
    bodies = [charged(make, name)[0] for name in names]
    r = charged(make)[1]
    moment, neutral = q @ r, (q - q.mean()) @ r
    fields = [
        make.field(E, CHARGES, body=names[0]),
        make.field(E, float(q.sum()), body=names[1], at=(moment / q.sum()).tolist()),
        make.field(E, float(q.sum()), moment.tolist(), body=names[2]),
        make.field(E, (q - q.mean()).tolist(), body=names[3]),
    ]
    found = make.arrays(make.case(*bodies, force=fields, t_end=1.0, dt=0.02))
    for k in (1, 2):
        assert found.position[:, k] == pytest.approx(found.position[:, 0], abs=1e-13)
        assert found.orientation[:, k] == pytest.approx(found.orientation[:, 0], abs=1e-13)
    assert np.abs(found.position[-1, 0] - found.position[-1, 3]).max() > 0.1
    assert found.linear_momentum[:, 3] == pytest.approx(
        np.tile(found.linear_momentum[0, 3], (11, 1))
    )
    R = make.rotation(START["orientation"])
    first = found.angular_momentum[0, 3] + 1e-6 * np.cross(R.apply(neutral), E)
    early = make.arrays(make.case(bodies[3], force=fields[3:], t_end=1e-6, every=1e-6))
    assert early.angular_momentum[-1, 0] == pytest.approx(first, abs=1e-10)


@pytest.mark.parametrize("offset", [[0.0, 0, 0], [1000.1, -2000.2, 300.3]])
def test_charges_in_proportion_to_the_masses_only_pull(make, offset):
    """Their centre is the centre of mass but for rounding, which must not make a body step.

    It is that of the places in the axes of the shape, whose origin may be far away.
    """
    body, r, mass = charged(make)
    body["shape"]["position"] = r + offset
    field = make.field([1.0, 2.0, 3.0], (3.0 * mass).tolist())
    found = make.arrays(make.case(body, force=[field]))
    assert "closed form" in found.plan.splitlines()[-1]
    spin = found.angular_momentum[:, 0]
    assert spin == pytest.approx(np.tile(spin[0], (11, 1)), abs=1e-14)


def test_bodies_of_different_particles_have_moments_of_their_own(make):
    """Two clouds and a body of as many particles under one [[force]]."""
    cloud = {"type": "cloud", "radius": 0.5, "n": 8}
    clouds = {"name": "cloud", "shape": cloud, "mass": 2.0, "count": 2}
    clouds |= {"position": [[0, 0, 0], [5, 0, 0]]}
    body, r, _ = charged(make)
    E, h = np.array([0.4, 1.0, -0.7]), 1e-6
    field = make.field(E, CHARGES, body=["cloud", "body"])
    with particlerb.run(make.case(clouds, body, force=[field], t_end=h, every=h)) as t:
        L = t.angular_momentum[-1] - t.angular_momentum[0]
        particles, centres = t.particle_positions(-1), t.position[-1]
    for k in range(2):
        arms = particles[8 * k : 8 * (k + 1)] - centres[k]
        assert L[k] == pytest.approx(h * np.cross(CHARGES @ arms, E), abs=1e-11)
    turned = make.rotation(START["orientation"]).apply(CHARGES @ r)
    assert L[2] == pytest.approx(h * np.cross(turned, E), abs=1e-10)
    assert np.abs(L[0] - L[1]).max() > 1e-7


WRONG_FIELDS = [
    # inertia, field, key, words
    (None, {"charge": [1.0] * 3}, "charge", "thing has 8 particles, the list 3 charges"),
    ([0, 0, 0], {"dipole": [0, 0, 1]}, "dipole", "but this field would"),
    ([0, 0, 0], {"charge": 1.0, "at": [0, 0, 1]}, "at", "act at the centre of mass"),
    ([1.3, 1.3, 0.0], {"dipole": [0, 1, 1]}, "dipole", "give a dipole along the rod's axis"),
    ([1.3, 1.3, 0.0], {"charge": 1.0, "at": [0, 1, 1]}, "at", "act at a point of the rod's axis"),
    ([1, 2, 2.5], {"charge": 1e200, "field": [1e200, 0, 0]}, "field", "beyond the range"),
    ([1, 2, 2.5], {"dipole": [1e200, 0, 0], "field": [0, 1e200, 0]}, "field", "beyond the range"),
]


@pytest.mark.parametrize(("inertia", "keys", "key", "words"), WRONG_FIELDS)
def test_a_field_that_cannot_act_so_has_one_clear_message(make, inertia, keys, key, words):
    body = charged(make, "thing")[0] if inertia is None else make.body("thing", inertia)
    field = make.field([0, 0, 1.0], body="thing") | keys
    with pytest.raises(CaseError) as caught:
        particlerb.run(make.case(body, force=[field]))
    (problem,) = caught.value.problems
    assert problem.key == f"force[0].{key}"
    assert words in str(problem)


def test_a_rod_may_have_charges_and_a_dipole_along_its_axis(make):
    """Also where the charges cancel but for rounding."""
    rod = {"name": "rod", "shape": {"type": "rod", "length": 1.0, "n": 5}, "mass": 1.0}
    rod |= {"orientation": [0.9, 0.1, -0.3, 0.2]}
    for charge, dipole in (([0.1] * 5, [0, 0, 0]), ([0.1, 0, 0, 0, -0.1], [0, 0, 0.2])):
        field = make.field([1.0, 0, 0], charge, dipole, body="rod")
        found = make.arrays(make.case(rod, force=[field], t_end=1.0, dt=0.05))
        assert np.isfinite(found.orientation).all()
    assert np.abs(found.angular_momentum[-1]).max() > 0.01


def test_a_spring_of_its_initial_length_starts_without_a_force(make):
    """One [[force]] on bodies at different distances: none moves; pulled aside, each swings."""
    rows = {"position": [[0, 0, -1.0], [0.3, 0, -2.0], [2.0, 1.0, 0.5]], "count": 3}
    spring = make.spring([0, 0, 1.0], 3.0, "initial", [0.1, 0.2, 0.3])
    found = make.arrays(make.case(make.body(**rows), force=[spring], dt=0.05))
    assert np.abs(found.linear_momentum).max() < 1e-14
    rows["velocity"] = [[0.5, 0, 0]] * 3
    ways = np.array(rows["position"]) - [-0.1, -0.2, 0.7]  # the anchor less the point
    lengths = np.linalg.norm(ways, axis=1)
    each = [
        spring | {"rest_length": float(length), "body": f"body[{k}]"}
        for k, length in enumerate(lengths)
    ]
    one, other = (
        make.arrays(make.case(make.body(**rows), force=force, dt=0.05))
        for force in ([spring], each)
    )
    assert one.position == pytest.approx(other.position, abs=1e-14)
    assert np.abs(one.angular_momentum[-1]).min(axis=0).max() > 1e-3


# Edges in time, and wrong input


def test_a_spring_acts_while_it_is_there(make):
    """Free before and after; in between the momentum that an integration from there on gives."""
    spring = make.spring([0.5, 1.0, 2.0], 3.0, 0.7, [0.4, -0.3, 0.2])
    force = [spring | {"during": [0.3, 0.7]}]
    keys = {"t_end": 1.0, "every": 0.1, "method": "dop853", "tolerance": 1e-13}
    found = make.arrays(make.case(make.body(**START), force=force, **keys))
    p = found.linear_momentum[:, 0]
    assert (p[:4] == p[0]).all()
    assert (p[7:] == p[7]).all()
    from_there = {
        name: getattr(found, name)[3, 0]
        for name in ("position", "velocity", "orientation", "angular_velocity")
    }
    true = make.integrate(np.diag(INERTIA), MASS, from_there, [spring], [0.4])
    assert p[7] == pytest.approx(MASS * true.velocity[0], abs=1e-12)
    expected = true.angular_momentum[0]
    assert found.angular_momentum[7:, 0] == pytest.approx(np.tile(expected, (4, 1)), abs=1e-12)


ROD, POINT = [1.3, 1.3, 0.0], [0.0, 0.0, 0.0]
WRONG = [
    ({"type": "spring", "stiffness": 1.0}, "force[0].anchor: missing"),
    ({"type": "spring", "anchor": [0, 0, 1]}, "force[0].stiffness: missing"),
    (
        {"type": "spring", "anchor": [0, 0, 1], "stiffness": -2.0},
        "force[0].stiffness: must be > 0, got -2.0",
    ),
    (
        {"type": "spring", "anchor": [0, 0, 1], "stiffness": 1.0, "rest_length": -1},
        "force[0].rest_length: must be >= 0, got -1",
    ),
    ({"type": "central"}, "force[0].mu: missing"),
    ({"type": "central", "mu": 0}, "force[0].mu: must be > 0, got 0"),
    ({"type": "central", "mu": -1.0}, "force[0].mu: must be > 0, got -1.0"),
    ({"type": "drag", "translation": -1}, "force[0].translation: must be >= 0, got -1"),
    ({"type": "drag", "rotation": "much"}, "force[0].rotation: must be a number, got a text"),
    ({"type": "drag", "frame": "body"}, "force[0].frame: unknown key"),
]


@pytest.mark.parametrize(("force", "words"), WRONG)
def test_wrong_numbers_of_a_field_have_one_clear_message(make, force, words):
    with pytest.raises(CaseError) as caught:
        particlerb.run(make.case(make.body(), force=[force | {"body": "body"}]))
    assert words in str(caught.value)
    assert len(caught.value.problems) == 1


@pytest.mark.parametrize(
    ("inertia", "words"),
    [(ROD, "act at a point of the rod's axis"), (POINT, "act at the centre of mass")],
)
def test_a_spring_that_would_turn_what_cannot_turn_is_an_error(make, inertia, words):
    spring = make.spring([0, 0, 1.0], 2.0, 0.0, [0.1, 0, 0], body="thing")
    with pytest.raises(CaseError) as caught:
        particlerb.run(make.case(make.body("thing", inertia), force=[spring]))
    assert words in str(caught.value)
    assert "this spring would" in str(caught.value)


@pytest.mark.parametrize("method", ["auto", "dop853"])
def test_a_body_that_starts_in_the_centre_is_an_error(make, method):
    with pytest.raises(CaseError, match=r"force\[0\]\.centre: body starts exactly at this centre"):
        particlerb.run(make.case(make.body(), force=[make.central(1.0)], method=method))


def test_a_spring_on_the_axis_of_a_rod_swings_it_and_leaves_its_spin_zero(make):
    spring = make.spring([1.0, 0, 1.0], 2.0, 0.3, [0, 0, 0.5])
    found = make.arrays(make.case(make.body(inertia=ROD), force=[spring], t_end=2.0, dt=0.05))
    axes = make.rotation(found.orientation[:, 0]).apply([0, 0, 1])
    assert np.abs(axes[-1] - axes[0]).max() > 0.1
    assert np.abs((found.angular_momentum[:, 0] * axes).sum(axis=1)).max() < 1e-14
