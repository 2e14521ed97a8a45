"""Forces between two bodies that users write act as built-in ones do in every method, keep momenta,
and are checked against their potential on both bodies.
"""

from pathlib import Path

import numpy as np
import pytest

import particlerb
from particlerb import CaseError, RunError, Scene, Simulation
from particlerb.integrators import METHODS
from particlerb.maths.quaternion import turn
from particlerb.maths.vec3 import add_scaled, cross, dot, scale, subtract
from particlerb.stepping import pair_forces
from particlerb.tables import (
    AttractionTable,
    Ball,
    ContactTable,
    Moments,
    PushTable,
    PythonTable,
    RunTable,
    SpringTable,
    TimedLoad,
)

plain = pytest.mark.plain
NO_TORQUE = (0.0, 0.0, 0.0)
ENDS = {"at1": (0.3, 0.1, -0.2), "at2": (-0.2, 0.3, 0.1)}
TIE = {"stiffness": 5.0, "rest_length": 0.4, "at": ENDS["at1"], "to_at": ENDS["at2"]}


def span(x1, R1, x2, R2, at1, at2):
    """From a point of the first to one of the second."""
    return subtract(add_scaled(1.0, x2, turn(R2, at2)), add_scaled(1.0, x1, turn(R1, at1)))


def tie_energy(x1, R1, x2, R2, at1, at2, k, l0):
    d = span(x1, R1, x2, R2, at1, at2)
    s = np.sqrt(dot(d, d)) - l0
    return 0.5 * k * s * s


@particlerb.force(potential=tie_energy)
def own_tie(x1, R1, x2, R2, at1, at2, k, l0):
    d = span(x1, R1, x2, R2, at1, at2)
    F = scale(k * (1.0 - l0 / np.sqrt(dot(d, d))), d)
    return F, cross(turn(R1, at1), F)


@particlerb.force
def tie_without_potential(x1, R1, x2, R2, at1, at2, k, l0):
    d = span(x1, R1, x2, R2, at1, at2)
    F = scale(k * (1.0 - l0 / np.sqrt(dot(d, d))), d)
    return F, cross(turn(R1, at1), F)


@particlerb.force
def own_dashpot(x1, R1, v1, omega1, x2, R2, v2, omega2, at1, at2, c):
    r1, r2 = turn(R1, at1), turn(R2, at2)
    d = span(x1, R1, x2, R2, at1, at2)
    ends = add_scaled(1.0, v2, cross(omega2, r2)), add_scaled(1.0, v1, cross(omega1, r1))
    F = scale(c * dot(subtract(*ends), d) / dot(d, d), d)
    return F, cross(r1, F)


@particlerb.force
def slip(x1, v1, omega1, x2, v2, omega2, c):
    """A friction that grows with the speed: its torque turns both."""
    u, w = subtract(v2, v1), subtract(omega2, omega1)
    return scale(c * (1.0 + dot(u, u)), u), scale(c * dot(w, w), w)


@particlerb.force
def growing(t, x1, x2, slope):
    return scale(t, slope), cross(scale(0.5, subtract(x2, x1)), scale(t, slope))


def newton_energy(x1, x2, m1, m2, G):
    d = subtract(x2, x1)
    return -G * m1 * m2 / np.sqrt(dot(d, d))


@particlerb.force(potential=newton_energy)
def newton(x1, x2, m1, m2, G):
    d = subtract(x2, x1)
    r2 = dot(d, d)
    return scale(G * m1 * m2 / (r2 * np.sqrt(r2)), d), NO_TORQUE


def scene(*forces, method="strang", dt=0.01, t_end=0.5, **keys):
    """Two asymmetric bodies whose rotor frames are others than theirs."""
    run = {} if METHODS[method].is_adaptive else {"dt": dt}
    made = Scene(RunTable(t_end=t_end, every=0.25, method=method, **run), **keys)
    state = {"position": (0.5, -0.2, 0.4), "velocity": (1.0, 0.3, -0.5)}
    state |= {"angular_velocity": (0.4, 1.1, -0.7), "orientation": (0.8, 0.4, -0.4, 0.2)}
    made.add_body(name="a", shape=Moments(inertia=(2.5, 1.0, 2.0)), mass=2.0, **state)
    state |= {"position": (1.7, 0.1, 0.3), "angular_velocity": (-0.5, 0.2, 0.9)}
    made.add_body(name="b", shape=Moments(inertia=(1.5, 2.0, 1.0)), mass=1.0, **state)
    for force in forces:
        made.add_force(force)
    return made


def between(function, **keys):
    """The force of a function on both bodies."""
    ends = {key: keys.pop(key) for key in ("body", "to", "reach", "per_body") if key in keys}
    return PythonTable(function=function, parameters=keys, **({"body": "a", "to": "b"} | ends))


def states(made):
    with particlerb.run(made) as t:
        return np.concatenate([t.position, t.orientation, t.velocity, t.angular_velocity], axis=2)


# What they do


@plain
@pytest.mark.parametrize("function", [own_tie, tie_without_potential])
@pytest.mark.parametrize("method", ["strang", "rkn6", "rk4", "dop853", "semi_implicit_euler"])
def test_a_tie_is_the_spring_of_the_package(method, function):
    """The same motion; without a potential what it does is work, and the balance closes alike."""
    own = scene(between(function, **ENDS, k=5.0, l0=0.4), method=method)
    built_in = scene(SpringTable(body="a", to="b", **TIE), method=method)
    most = 1e-8 if METHODS[method].is_adaptive else 1e-12  # where the first step is estimated
    assert np.abs(states(own) - states(built_in)).max() < most
    with particlerb.run(own) as t, particlerb.run(built_in) as u:
        kept = t.ledger.potential_energy[:] - t.ledger.work[:]
        kept -= kept[0] - u.ledger.potential_energy[0]
        least = 1e-11 if method == "rkn6" else 1e-2 if function is tie_without_potential else most
        assert kept == pytest.approx(u.ledger.potential_energy[:], abs=least)
        assert np.abs(t.ledger.linear_momentum_error[:]).max() < 1e-13


@plain
@pytest.mark.parametrize("method", ["rk4", "dop853", "momentum_euler", "explicit_euler"])
def test_a_dashpot_is_that_of_the_package(method):
    own = scene(between(own_dashpot, **ENDS, c=0.7), method=method)
    own.add_force(between(own_tie, **ENDS, k=5.0, l0=0.4))
    built_in = scene(SpringTable(body="a", to="b", **TIE, damping=0.7), method=method)
    most = 1e-8 if METHODS[method].is_adaptive else 1e-12
    assert np.abs(states(own) - states(built_in)).max() < most


@pytest.mark.slow
def test_a_dashpot_is_a_flow_in_strang():
    """A midpoint rule in place of an exponential: apart by the order of the method."""
    apart, errors = [], []
    for dt in (0.02, 0.01):
        own = scene(between(own_dashpot, **ENDS, c=0.7), dt=dt)
        own.add_force(between(tie_without_potential, **ENDS, k=5.0, l0=0.4))
        built_in = scene(SpringTable(body="a", to="b", **TIE, damping=0.7), dt=dt / 16)
        apart.append(np.abs(states(own)[-1] - states(built_in)[-1]).max())
        with particlerb.run(own) as t:
            errors.append(np.abs(t.ledger.energy_error[:]).max())
            assert np.abs(t.ledger.linear_momentum_error[:]).max() < 1e-13
            assert np.abs(t.ledger.angular_momentum_error[:]).max() < 1e-13
    assert np.log2(apart[0] / apart[1]) == pytest.approx(2.0, abs=0.15)
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.15)


@plain
def test_friction_of_pairs_is_of_order_two_and_keeps_momenta():
    """Work is exact: at a fixed pose the midpoint rule loses what counts, a drift nothing."""
    pulled = PushTable(body="a", force=(1.0, 0.5, 0.0))
    last = {}
    for dt in (0.05, 0.025, 0.0125, 0.00125):
        made = scene(between(slip, c=0.8), pulled, dt=dt)
        made.body[1] = made.body[1].model_copy(update={"velocity": (-1.0, 0.0, 0.4)})
        with particlerb.run(made) as t:
            last[dt] = np.concatenate([t.velocity[-1], t.angular_velocity[-1]])
            assert np.abs(t.ledger.linear_momentum_error[:]).max() < 1e-13
            assert np.abs(t.ledger.angular_momentum_error[:]).max() < 1e-13
            assert np.abs(t.ledger.energy_error[:]).max() < 0.8 * dt * dt
            assert t.ledger.work[-1] < -0.5
    errors = [np.abs(last[dt] - last[0.00125]).max() for dt in (0.05, 0.025, 0.0125)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.15)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(2.0, abs=0.15)


@plain
@pytest.mark.parametrize("method", ["strang", "rkn6", "rk4", "dop853"])
def test_time_is_that_of_the_scene(method):
    """F = s t half way between the bodies from 0.1 s on, and an impulse that begins a segment."""
    slope = np.array([2.0, -1.0, 0.5])
    force = between(growing, slope=tuple(slope)).model_copy(update={"during": (0.1, 0.4)})
    knots = {"times": (0.1, 0.4), "values": np.outer([0.1, 0.4], slope)}
    both = [
        PushTable(body=body, force=TimedLoad(times=knots["times"], values=sign * knots["values"]))
        for body, sign in (("a", 1.0), ("b", -1.0))
    ]
    own, built_in = states(scene(force, method=method)), states(scene(*both, method=method))
    most = 1e-9 if METHODS[method].is_adaptive else 1e-12
    assert np.abs(own[..., :3] - built_in[..., :3]).max() < most
    assert np.abs(own[..., 7:10] - built_in[..., 7:10]).max() < most


@plain
def test_every_pair_in_reach_takes_numbers_of_both_bodies():
    """G m m'/r² between points is [attraction]."""
    run, random = RunTable(t_end=0.5, every=0.25, method="rkn6", dt=0.05), np.random.default_rng(3)
    places, masses = random.normal(size=(5, 3)), (1.0, 2.0, 0.5, 3.0, 1.5)
    made, built_in = Scene(run), Scene(run, attraction=AttractionTable(G=0.3))
    for one in (made, built_in):
        for k, (place, mass) in enumerate(zip(places, masses, strict=True)):
            point = Moments(inertia=(0, 0, 0))
            one.add_body(name=f"p{k}", shape=point, mass=mass, position=tuple(place))
    everyone = tuple(f"p{k}" for k in range(5))
    charges = {"m1": np.array(masses), "m2": np.array(masses)}
    made.add_force(
        PythonTable(
            body=everyone, reach=1e6, function=newton, parameters={"G": 0.3}, per_body=charges
        )
    )
    assert np.abs(states(made) - states(built_in)).max() < 1e-13
    with particlerb.run(made) as t, particlerb.run(built_in) as u:
        assert t.ledger.potential_energy[:] == pytest.approx(u.ledger.potential_energy[:])
        assert not t.angular_momentum[:].any()
        assert "10 pairs of newton" in t.parameter("plan")


@pytest.mark.compiled
def test_two_threads_change_no_bit(monkeypatch):
    """Pairs of a large scene are evaluated by a kernel of their own, not in that of the steps."""
    made, found = scene(between(own_tie, **ENDS, k=5.0, l0=0.4), between(slip, c=0.8)), []
    monkeypatch.setattr(pair_forces, "WORTH_THREADS", 0.0)
    for threads in (1, 2):
        made.run = made.run.model_copy(update={"threads": threads})
        found.append(states(made))
    assert np.array_equal(*found)


@plain
def test_the_step_follows_the_stiffness_of_the_pair_and_a_parameter_may_change():
    steps = []
    for force in (
        between(own_tie, **ENDS, k=800.0, l0=0.4),
        SpringTable(body="a", to="b", **TIE | {"stiffness": 800.0}),
    ):
        made = scene(force)
        made.run = RunTable(t_end=0.5, every=0.25, method="strang")
        with particlerb.run(made) as t:
            line = next(x for x in t.parameter("plan").splitlines() if "step  " in x)
            steps.append(float(line.split()[1]))
    assert steps[0] == pytest.approx(steps[1], rel=0.6)
    simulation = Simulation(scene(between(own_tie, **ENDS, k=1.0, l0=0.4)))
    simulation.advance(until=0.2)
    simulation.change("force[0].parameters.k", 0.0)
    v = np.array(simulation.advance(until=0.3).velocity)
    assert np.array_equal(simulation.advance(until=0.5).velocity, v)
    assert abs(simulation.energy_error) < 1e-3


@plain
def test_bodies_of_a_pair_are_not_merged():
    def made(merge):
        one = scene(between(own_tie, **ENDS, k=5.0, l0=0.4), method="rattle")
        for k, x in ((0, 0.0), (1, 3.0)):
            still = {"velocity": (0, 0, 0), "angular_velocity": (0, 0, 0), "position": (x, 0, 0)}
            one.body[k] = one.body[k].model_copy(update=still)
        one.add_body(name="c", shape=Moments(inertia=(1.0, 1.0, 1.0)), mass=1.0, position=(4, 0, 0))
        one.add_joint(type="fixed", body="b", to="c", merge=merge)
        return states(one)

    assert np.array_equal(made(True), made(False))


@plain
def test_a_case_names_a_function_of_two_bodies(tmp_path):
    made = scene(between(own_tie, **ENDS, k=5.0, l0=0.4))
    (tmp_path / "own_tie.py").write_text(own_tie.text())
    (tmp_path / "case.toml").write_text(made.to_toml())
    with pytest.raises(CaseError, match=r"force\[0\].function: .*holds code"):
        particlerb.run(tmp_path / "case.toml")
    with particlerb.run(tmp_path / "case.toml", allow_code=True) as t:
        assert np.array_equal(t.position, states(made)[..., :3])


# What is refused


def wrong_energy(x1, x2, k):
    """A pull to the origin of the world beside that of the other body."""
    d = subtract(x2, x1)
    return 0.5 * k * dot(d, d) + 0.01 * dot(x2, x2)


@particlerb.force(potential=wrong_energy)
def not_on_both(x1, x2, k):
    return scale(k, subtract(x2, x1)), NO_TORQUE


@particlerb.force
def sideways(x1, x2):
    return (0.0, 0.0, 1.0), NO_TORQUE


@particlerb.force
def too_late(t, x1, x2):
    if t > 0.3:
        raise ValueError("too late")
    return NO_TORQUE, NO_TORQUE


@particlerb.force
def no_root(t, x1, x2):
    return (np.sqrt(0.3 - t), 0.0, 0.0), NO_TORQUE


@particlerb.force
def alone(x):
    return x, NO_TORQUE


def line_of(text):
    """File and line of the first line of this file that is so."""
    return f"{__file__}:{Path(__file__).read_text().splitlines().index(text) + 1}"


@plain
@pytest.mark.parametrize(
    ("force", "error", "where", "words"),
    [
        (between(not_on_both, k=1.0), CaseError, "@particlerb.force(potential=wrong_energy)",
         r"force\[0\].function: .* for a and b, on the second, and its potential"),
        (between(too_late), RunError, '        raise ValueError("too late")', "ValueError"),
        (between(no_root), RunError, None, r"no_root returns \[\[nan, 0.0, 0.0\]"),
        (between(newton, m1=1.0, m2=1.0), CaseError, None, "parameter G, which is missing"),
        (between(newton, G=1.0, m1=1.0, per_body={"m2": [1.0, 2.0]}), CaseError, None,
         r"force\[0\].per_body.m2: has 2 entries, .* on 1 body"),
        (between(own_tie, **ENDS, l0=0.4, per_body={"k": [1.0]}), CaseError, None,
         r"force\[0\].per_body.k: says not of which body"),
        (between(alone), CaseError, None, r"force\[0\].to: alone .* acts on one body"),
        (PythonTable(body="a", function=sideways), CaseError, None,
         r"force\[0\].to: sideways .* acts between two bodies"),
        (between(sideways, to="a"), CaseError, None, r"force\[0\].to: ties a to itself"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_with_its_line(force, error, where, words):
    with pytest.raises(error, match=words) as info:
        particlerb.run(scene(force))
    if where:
        assert line_of(where) in str(info.value)


@plain
def test_points_are_not_turned_and_methods_refuse_what_they_cannot():
    made = scene(between(sideways))
    made.body[1] = made.body[1].model_copy(
        update={"shape": Moments(inertia=(0, 0, 0)), "angular_velocity": (0, 0, 0)}
    )
    with pytest.raises(CaseError, match="sideways turns a point of a and b"):
        particlerb.run(made)
    for method, force in (("rkn6", between(slip, c=1.0)), ("force_gradient", between(sideways))):
        with pytest.raises(CaseError, match=f"does not accept .*{force.function.name}"):
            particlerb.run(scene(force, method=method))
    with pytest.raises(TypeError, match="x is of one body, and x2 of two"):
        particlerb.force(lambda_of_both)


def lambda_of_both(x, x2):
    return x, x2


@particlerb.force
def own_push(x1, x2, q1):
    return (q1, 0.0, 0.0), NO_TORQUE


@plain
def test_numbers_of_bodies_come_in_the_order_in_which_they_are_named():
    """Not in that of the scene: c pushes b with 1 N, a and d do nothing."""
    made = Scene(RunTable(t_end=1.0, every=1.0, method="rk4", dt=0.1))
    for k, name in enumerate("abcd"):
        made.add_body(name=name, shape=Moments(inertia=(1, 1, 1)), mass=1.0, position=(0, k, 0))
    asked = {"body": ["c", "a"], "to": ["b", "d"], "per_body": {"q1": [1.0, 0.0]}}
    made.add_force(PythonTable(function=own_push, **asked))
    with particlerb.run(made) as t:
        assert t.velocity[-1, :, 0] == pytest.approx([0.0, -1.0, 1.0, 0.0], abs=1e-14)


def stretch_energy(x1, x2, k):
    """½ k r²."""
    d = subtract(x2, x1)
    return 0.5 * k * dot(d, d)


@particlerb.force(potential=stretch_energy)
def stretch(x1, x2, k):
    """Towards the other, as far as it is away."""
    return scale(k, subtract(x2, x1)), NO_TORQUE


@plain
def test_a_pair_that_attracts_bounces_by_impulses():
    """r = 0.6 cos ωt until it is 0.2, and then back; an impact within a step errs by some h."""
    omega, errors, energies = np.sqrt(20.0 * 1.5), [], []
    turn_back = 2.0 * np.arccos(0.2 / 0.6) / omega
    for dt in (5e-3, 2.5e-3):
        scene = Scene(RunTable(t_end=0.4, every=0.4, dt=dt))
        for name, mass, x in (("a", 1.0, -0.3), ("b", 2.0, 0.3)):
            scene.add_body(name=name, shape=Ball(radius=0.1), mass=mass, position=(x, 0, 0))
        scene.contact = ContactTable(law="impulse", restitution=1.0, friction=0.0)
        scene.add_force(PythonTable(body="a", to="b", function=stretch, parameters={"k": 20.0}))
        with particlerb.run(scene) as found:
            r = found.position[-1, 1, 0] - found.position[-1, 0, 0]
            assert not found.ledger.linear_momentum_error.any()
            energies.append(abs(found.ledger.energy_error[-1]))
        errors.append(abs(r - 0.6 * np.cos(omega * (0.4 - turn_back))))
    assert errors[1] < 0.6 * errors[0] < 0.004
    assert energies[1] < 0.3 * energies[0] < 3e-5
