"""Orders of all methods, measured; the tolerance and the dense output of the adaptive one.

Errors are root mean squares over several asymmetric bodies, which is smooth in the step where a
single component of a single body is not.
"""

import numpy as np
import pytest

import particlerb
from particlerb.case.problems import CaseError
from particlerb.forces.kinds import VELOCITY
from particlerb.integrators import METHODS, UNJOINTED, rkn6

T_END = 6.4
N = 6
STEPPERS = [m for m in UNJOINTED if METHODS[m].order and not METHODS[m].is_adaptive]
FREE_ORDER = {name: METHODS[name].order for name in STEPPERS} | {"rkn6": 8, "force_gradient": 8}
SYMPLECTIC = ("strang", "force_gradient", "rkn6")


def bodies(make, n=N, inertia=(1.0, 2.0, 2.5), **keys):
    """Bodies that start anywhere, turning at some 1.3 rad/s."""
    rng = np.random.default_rng(11)
    rows = {
        "position": [1.0, 0.2, 0.3] + 0.3 * rng.standard_normal((n, 3)),
        "velocity": 0.3 * rng.standard_normal((n, 3)),
        "orientation": rng.standard_normal((n, 4)),
        "angular_velocity": 0.75 * rng.standard_normal((n, 3)),
    }
    return make.body(inertia=inertia, count=n, **rows | keys)


def fields(make):
    """A push, two springs and a centre: what depends on the pose alone."""
    return [
        make.push([1.0, 2.0, -1.5], [0.4, -0.3, 0.2]),
        make.spring([0, 0, 4.0], 1.5, 0.5, [0.1, 0.2, 0.3]),
        make.spring([1, 1, 1.0], 2.0, 0.0, [0.1, 0.2, 0.3]),
        make.central(3.0, [5.0, 0, 0]),
    ]


def all_kinds(make):
    """The same with drag and loads that have no potential."""
    others = [make.push([1.0, 0, 0], [0, 0.1, 0], frame="body"), make.torque([0.1, 0.2, 0.3])]
    return fields(make) + others + [make.drag(0.3, 0.2)]


def forces_for(make, method):
    return all_kinds(make) if VELOCITY in METHODS[method].accepts else fields(make)


def errors(make, found, true):
    """Root mean squares at the end: angle [rad], way [m], angular momentum [kg m²/s]."""
    apart = [make.angle(found.orientation[-1], true.orientation[-1])]
    for name in ("position", "angular_momentum"):
        difference = getattr(found, name)[-1] - getattr(true, name)[-1]
        apart.append(np.linalg.norm(difference, axis=1))
    return np.sqrt(np.mean(np.square(apart), axis=1))


def measured(make, force, method, steps, t_end=T_END, start=None):
    """Errors of runs with these steps, (number of steps, 3)."""
    start = start or bodies(make)
    keys = {"t_end": t_end, "every": t_end}
    closed = {"method": "dop853", "tolerance": 1e-14} if force else {"method": "exact"}
    ghosts = make.ghosts(field=False) if force else []
    true = make.arrays(make.case(start, force=[*force, *ghosts], **keys, **closed))
    keys |= {"force": force, "method": method}
    runs = (make.arrays(make.case(start, **keys, dt=dt)) for dt in steps)
    return np.array([errors(make, found, true) for found in runs])


def order(steps, errors):
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


# Where the first term of the error's series is all there is, and well above rounding: of rkn6,
# three halvings, since a fourth would need 2²⁴ between the two.
FIRST_STEP = {
    "strang": 0.05,
    "rkn6": 0.4,
    "force_gradient": 0.2,
    "rk4": 0.05,
    "semi_implicit_euler": 2e-3,
    "explicit_euler": 2e-3,
    "momentum_euler": 2e-3,
}


@pytest.mark.compiled
@pytest.mark.parametrize("method", STEPPERS)
def test_order_under_all_forces_that_a_method_accepts(make, method):
    halvings = 3 if method == "rkn6" else 4
    steps = FIRST_STEP[method] / 2.0 ** np.linspace(0, halvings, 7)
    found = measured(make, forces_for(make, method), method, steps)
    assert found[-1].min() > 1e-12
    for kind in found.T:
        assert order(steps, kind) == pytest.approx(METHODS[method].order, abs=0.1)


@pytest.mark.compiled
def test_strang_keeps_order_two_where_drag_and_torques_act(make):
    steps = 0.1 / 2.0 ** np.arange(5)
    force = [make.torque([0.5, -1.0, 0.7]), make.drag(0.6, 0.8), *all_kinds(make)]
    for kind in measured(make, force, "strang", steps).T:
        assert order(steps, kind) == pytest.approx(2, abs=0.05)


@pytest.mark.compiled
@pytest.mark.parametrize("method", [name for name in STEPPERS if FREE_ORDER[name] < 8])
def test_order_on_free_bodies(make, method):
    steps = FIRST_STEP[method] / 2.0 ** np.arange(5)
    turn, way, spin = measured(make, [], method, steps).T
    assert order(steps, turn) == pytest.approx(FREE_ORDER[method], abs=0.1)
    assert way.max() < 1e-11  # a straight line, but for the roundings of up to 5e4 steps
    if method in ("semi_implicit_euler", "explicit_euler"):
        assert order(steps, spin) == pytest.approx(FREE_ORDER[method], abs=0.1)
    else:
        assert not spin.any()


@pytest.mark.compiled
def test_order_of_rkn6_on_free_bodies_is_eight(make):
    """Two halvings, a factor of 65 000; the longest map takes 0.29 dt, at 1.9 rad/s."""
    steps = 0.84 / 2.0 ** np.linspace(0, 2, 9)
    turn, way, spin = measured(make, [], "rkn6", steps, t_end=32.0).T
    assert 1e-12 < turn[-1] < turn[0] < 1e-6
    assert order(steps, turn) == pytest.approx(FREE_ORDER["rkn6"], abs=0.1)
    assert way.max() < 1e-12
    assert not spin.any()


@pytest.mark.compiled
def test_error_of_rkn6_falls_with_the_step_where_the_rotor_makes_it(make):
    """Fast tops, whose weight hardly counts; steps of 2.6 rad and less.

    Where maps are bounded by 0.8 rad alone, the error grows fourfold at 2.1 rad, where the longest
    drift is no longer cut.
    """
    rng = np.random.default_rng(5)
    tilt = rng.uniform(0.1, 2.0, N)
    q = np.stack([np.cos(tilt / 2), np.sin(tilt / 2), 0 * tilt, 0 * tilt], axis=1)
    axis = np.stack([0 * tilt, -np.sin(tilt), np.cos(tilt)], axis=1)
    top = bodies(make, inertia=(1.0, 1.2, 0.6), orientation=q, angular_velocity=10.0 * axis)
    force = [make.push([0, 0, -1.0], [0, 0, 1.0]), make.push([0, 0, 1.0]), *make.ghosts()[:3]]
    steps = 0.255 / 2.0 ** (0.125 * np.arange(17))
    turn = measured(make, force, "rkn6", steps, t_end=3.0, start=top)[:, 0]
    assert (turn[1:] < turn[:-1]).all()
    assert order(steps, turn) == pytest.approx(FREE_ORDER["rkn6"], abs=0.3)


def test_kicks_and_drifts_of_rkn6_are_symmetric_and_sum_to_one():
    """(9.1) of docs/theory.md; the sixteenth digit is that of the published table."""
    kicks, drifts = np.array([*rkn6.KICKS, rkn6.KICKS[0]]), np.array(rkn6.DRIFTS)
    assert (kicks == kicks[::-1]).all()
    assert (drifts == drifts[::-1]).all()
    assert kicks.sum() == pytest.approx(1, abs=1e-15)
    assert drifts.sum() == pytest.approx(1, abs=1e-15)


# What drifts in closed form drifts exactly


AXIAL = {"rod": (1.3, 1.3, 0.0), "sphere": (1.7, 1.7, 1.7), "prolate": (2.0, 2.0, 0.5)}


@pytest.mark.parametrize("method", SYMPLECTIC)
@pytest.mark.parametrize("name", AXIAL)
def test_bodies_with_an_axis_drift_exactly(make, method, name):
    """Also on a parabola, since a constant force through the centre of mass is split exactly."""
    body = make.body(inertia=AXIAL[name], velocity=[1.0, 2.0, 3.0], angular_velocity=[1.5, 0, 0])
    if name != "rod":
        body["angular_velocity"] = [1.5, -0.4, 0.7]
    keys = {"t_end": 8.0, "every": 2.0, "gravity": {"acceleration": [0.3, 0, -9.81]}}
    found = make.arrays(make.case(body, **keys, method=method, dt=0.5))
    true = make.arrays(make.case(body, **keys, method="exact"))
    # 16 steps, 11 drifts in each with rkn6: roundings of 4e-16 of each
    assert make.angle(found.orientation[:, 0], true.orientation[:, 0]).max() < 1e-13
    assert found.position == pytest.approx(true.position, abs=1e-12)  # of 300 m
    assert (found.angular_momentum == found.angular_momentum[0]).all()


def test_points_fly_exactly_under_every_method(make):
    """Nothing turns, so a named method flies them in closed form."""
    body = make.body(inertia=[0, 0, 0], velocity=[1.0, 2.0, 3.0])
    for method in UNJOINTED:
        found = make.arrays(make.case(body, method=method, dt=0.1))
        assert "free, closed form" in found.plan
        assert found.position[-1, 0] == pytest.approx([1.0, 2.0, 3.0], abs=1e-15)


CLASSES = {"point": (0.0, 0.0, 0.0), **AXIAL, "asymmetric": (1.0, 2.0, 2.5)}


def marked(method):
    """Loops of three methods with classes and a spring are no other test's; strang's is theirs."""
    marks = [pytest.mark.plain] * (method in ("force_gradient", "rkn6", "dop853"))
    return pytest.param(method, marks=marks)


@pytest.mark.parametrize("method", [marked(name) for name in [*STEPPERS, "dop853"]])
def test_one_group_may_have_bodies_of_all_classes(make, method):
    """On a spring at the centre of mass, x = A cos ωt with ω = √(k/m) = 2 rad/s, and free turns."""
    keys = {"position": [1.0, 0, 0], "angular_velocity": {"body": [0.3, -0.2, 0.5]}}
    bodies = [make.body(name, inertia, **keys) for name, inertia in CLASSES.items()]
    bodies[0]["angular_velocity"] = [0, 0, 0]
    bodies[1]["angular_velocity"] = [0.3, -0.2, 0]
    t_end, dt = 0.5, {1: 1e-3, 2: 5e-3}.get(METHODS[method].order, 0.05)
    run = {"t_end": t_end, "method": method, "dt": dt}
    found = make.arrays(
        make.case(*bodies, force=[make.spring([0, 0, 0], 8.0, 0, body=list(CLASSES))], **run)
    )
    free = make.arrays(make.case(*bodies, t_end=t_end))
    # order 1: ω t ω dt/2; order 2: ω t (ω dt)²/24; order 4: (ω dt)⁴/120; all others: below 1e-9
    limit = {1: 1.1e-3, 2: 5e-6, 4: 1e-6}.get(METHODS[method].order, 1e-9)
    expected = np.tile(np.cos(2 * found.time)[:, None], (1, len(CLASSES)))
    assert found.position[:, :, 0] == pytest.approx(expected, abs=limit)
    apart = make.angle(found.orientation.reshape(-1, 4), free.orientation.reshape(-1, 4))
    assert apart.max() < limit
    assert not found.angular_momentum[:, 0].any()
    assert (found.orientation[:, 0] == found.orientation[0, 0]).all()


# DOP853


@pytest.mark.compiled
def test_dop853_keeps_its_tolerance(make):
    """Its error is below 10 tolerances per radian turned, here 8, and falls with the tolerance."""
    force, keys = all_kinds(make), {"t_end": T_END, "every": T_END, "method": "dop853"}
    tolerances = 10.0 ** -np.arange(3, 14, 2)
    true = make.arrays(make.case(bodies(make), force=force, **keys), "run.tolerance=1e-14")
    found = []
    for tolerance in tolerances:
        run = make.arrays(make.case(bodies(make), force=force, **keys, tolerance=tolerance))
        found.append(errors(make, run, true).max())
    assert (found < 80 * tolerances).all()
    assert np.polyfit(np.log(tolerances), np.log(found), 1)[0] == pytest.approx(1.0, abs=0.15)


@pytest.mark.compiled
@pytest.mark.parametrize("tolerance", [1e-5, 1e-9])
def test_frames_of_dop853_between_its_steps_are_as_good_as_these(make, tolerance):
    """Dense output of order 7: at 100 frames an error like that at the ends of steps."""
    force, keys = all_kinds(make), {"t_end": T_END, "every": T_END / 100, "method": "dop853"}
    found, true = (
        make.arrays(make.case(bodies(make), force=force, **keys, tolerance=one))
        for one in (tolerance, 1e-13)
    )
    apart = make.angle(found.orientation.reshape(-1, 4), true.orientation.reshape(-1, 4))
    apart = apart.reshape(-1, N).max(axis=1)
    assert apart.max() < 80 * tolerance
    assert apart.max() < 3 * apart[-10:].max()
    assert np.abs(np.linalg.norm(found.orientation, axis=-1) - 1).max() < 4e-16


@pytest.mark.compiled
def test_a_body_of_dop853_moves_alone_as_in_company(make):
    """Up to the tolerance: sixteen bodies take the same steps, those of the hardest one."""
    keys = {"force": all_kinds(make), "method": "dop853", "t_end": T_END, "every": 0.4, "dt": 0.1}
    together = make.arrays(make.case(bodies(make, 20), **keys, tolerance=1e-11))
    start = bodies(make, 20)
    for b in (0, 15, 16, 19):
        own = {name: start[name][b] for name in ("position", "velocity", "angular_velocity")}
        one = make.body(**own, orientation=start["orientation"][b])
        alone = make.arrays(make.case(one, **keys, tolerance=1e-11))
        assert make.angle(alone.orientation[:, 0], together.orientation[:, b]).max() < 8e-10
        assert alone.position[:, 0] == pytest.approx(together.position[:, b], abs=8e-10)


@pytest.mark.parametrize("tolerance", [0.0, -1e-8, 1e-15, 0.2])
def test_a_tolerance_out_of_range_is_refused(make, tolerance):
    with pytest.raises(CaseError, match=r"run\.tolerance: must be"):
        particlerb.run(make.case(make.body(), method="dop853", tolerance=tolerance))


@pytest.mark.compiled
@pytest.mark.parametrize("inertia", [(0.0, 0.0, 0.0), (1.3, 1.3, 0.0), (1.0, 2.0, 2.5)])
def test_dop853_takes_long_steps_where_a_body_rests(make, inertia):
    """Hanging still on a spring: all momenta are rounding, and so may their errors be."""
    body = make.body(inertia=inertia, position=[0.1, 0, -(0.5 + 2 * 9.81 / 80)])
    force = [make.spring([0.1, 0, 0], 80.0, 0.5)]
    keys = {"method": "dop853", "t_end": 20.0, "every": 1.0}
    found = make.arrays(
        make.case(body, force=force, gravity={"acceleration": [0, 0, -9.81]}, **keys)
    )
    assert found.position == pytest.approx(np.tile(found.position[0], (21, 1, 1)), abs=1e-12)


@pytest.mark.compiled
def test_dop853_brings_a_body_to_rest_by_drag(make):
    """Momenta fall below any number that a rounding error could be smaller than."""
    start = {"velocity": [0.3, 0.1, -0.2], "angular_velocity": [1.0, 0.4, -0.7]}
    force = [make.drag(20.0, 20.0), make.central(1e-300, [9, 9, 9])]
    keys = {"method": "dop853", "t_end": 200.0, "every": 10.0}
    found = make.arrays(make.case(make.body(**start), force=force, **keys))
    way = np.array(start["velocity"]) * 2.0 / 20.0  # v M/c
    assert found.position[-1, 0] == pytest.approx(way, abs=1e-9)
    assert np.abs(found.angular_velocity[-1, 0]).max() < 1e-9
