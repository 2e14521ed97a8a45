"""Motion of jointed bodies: references, orders, what is kept, and time reversal."""

import tomllib
from pathlib import Path

import mpmath
import numpy as np
import pytest
from holds import misfits
from scenes import SCENES, Y, Z, bar, body, case, four_bar, hinge_chain, joint, moved, reference

import particlerb
from particlerb import RunError, joint_loads
from particlerb.case.to_system import to_system
from particlerb.joints import iterations, solver
from particlerb.simulation.run import prepare

CASES = Path(__file__).parents[2] / "cases"
ORDERS = {"rattle": 2, "rattle4": 4, "rattle6": 6, "rattle8": 8}


def run_of(dt):
    """Keys of [run] for 30 steps, in frames of 10."""
    return {"t_end": 30 * dt, "every": 10 * dt, "dt": dt, "method": "rattle", "threads": 1}


def error(name, t, dt, method):
    """Largest error of a coordinate [m] at t."""
    with moved(SCENES[name](), t, dt, method) as trajectory:
        return np.abs(np.array(trajectory.position)[-1] - reference(name, t)[0]).max()


@pytest.mark.plain
@pytest.mark.parametrize(
    ("name", "dt", "most"),
    [("chain6", 1e-3, 2.2), ("double_rod", 5e-3, 2.6), ("bricard", 0.01, 3.3)],
)
def test_a_guess_of_the_impulses_saves_drifts(name, dt, most, monkeypatch):
    """Of smooth motion, once the steps before are known; 3.0, 4.0, 5.1 with a cubic."""
    drifts, fly = [], iterations.fly
    monkeypatch.setattr(iterations, "fly", lambda *args: (drifts.append(1), fly(*args)))
    with particlerb.Simulation({"run": run_of(dt), **SCENES[name]()}) as simulation:
        simulation.advance(20 * dt)
        drifts.clear()
        simulation.advance(30 * dt)
    assert len(drifts) <= most * 10


@pytest.mark.compiled
@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "t", "dt", "tolerance"),
    [("bricard", 1.0, 0.02, 1e-12), ("slider_crank", 1.0, 0.005, 1e-11),
     ("chain6", 0.5, 0.005, 1e-11), ("double_rod", 1.0, 0.01, 1e-12),
     ("mixed_chain", 0.8, 0.002, 1e-8)],
)  # fmt: skip
def test_mechanisms_are_where_independent_solutions_have_them(name, t, dt, tolerance):
    assert error(name, t, dt, "rattle8") < tolerance


@pytest.mark.compiled
@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "method", "steps"),
    [("double_rod", "rattle", (0.01, 0.005, 0.0025)),
     ("bricard", "rattle", (0.02, 0.01, 0.005)),
     ("slider_crank", "rattle", (0.005, 0.0025, 0.00125)),
     ("double_rod", "rattle4", (0.02, 0.01, 0.005)),
     ("bricard", "rattle4", (0.04, 0.02, 0.01)),
     ("slider_crank", "rattle4", (0.005, 0.0025, 0.00125)),
     ("double_rod", "rattle6", (0.02, 0.01, 0.005)),
     ("bricard", "rattle6", (0.05, 0.04, 0.025)),
     ("slider_crank", "rattle6", (0.005, 0.004, 0.0025)),
     ("double_rod", "rattle8", (0.025, 0.02, 0.0125)),
     ("chain6", "rattle8", (0.01, 0.00625, 0.005))],
)  # fmt: skip
def test_every_method_has_its_order(name, method, steps):
    t = 0.5 if name == "chain6" else 1.0
    errors = [error(name, t, dt, method) for dt in steps]
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert slope == pytest.approx(ORDERS[method], abs=0.1)


def test_a_double_rod_is_of_order_two_in_plain_python_too():
    coarse, fine = (error("double_rod", 0.5, dt, "rattle") for dt in (0.02, 0.01))
    assert coarse / fine == pytest.approx(4.0, rel=0.05)


ODD_JOINTS = case(
    [
        bar("plate", [-0.3, 0, 0], [0.3, 0, 0], 1.0, 0.2, [0.3, 0.0, 0.0], [0, 0, 1.0]),
        body("knob", 0.2, [1e-3, 2e-3, 2.5e-3], [0.4, 0.1, 0.1], [0.2, 0.4, 0], [0, 0, 1.0]),
        bar("arm", [0.4, 0.1, 0.1], [0.4, 0.1, -0.5], 0.3, 0.05, [0.2, 0.4, 0], [0, 0, 1.0]),
    ],
    [
        joint("planar", "plate", None, [0, 0, 0], [0, 0, 1]),
        joint("fixed", "knob", "plate", [0.3, 0, 0]),
        joint("hinge", "arm", "knob", [0.4, 0.1, 0.1], [1, 0, 0]),
    ],
    (0.0, 3.0, -9.81),
)


@pytest.mark.parametrize("is_closed", [True, False])
@pytest.mark.parametrize("coupler", [1e-6, 0.03, 90.0, 1e6])
def test_masses_far_apart_are_of_order_two_as_others(coupler, is_closed):
    """Steps so long that small errors of a guess of the impulses turn light bodies far."""
    errors = []
    for dt in (0.01, 0.005):
        with moved(four_bar(coupler, is_closed), 0.9, dt, every=0.1) as trajectory:
            errors.append(np.abs(np.array(trajectory.ledger.energy_error)).max())
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)
    assert errors[0] < 0.02 * 9.81 * max(coupler, 1.0)


@pytest.mark.parametrize("coupler", [1e-6, 1e6])
def test_a_step_is_chosen_for_how_fast_a_linkage_swings_not_one_light_link_by_itself(coupler):
    """Which √(m g/m_light) times as fast would be; a string of light links is as fast as it is."""
    string = [bar(f"b{k}", [0, 0, -0.1 * k], [0, 0, -0.1 * (k + 1)], 1e-3) for k in range(4)]
    string.append(bar("bob", [0, 0, -0.4], [0, 0, -0.5]))
    joints = [joint("hinge", f"b{k}", f"b{k - 1}" if k else None, [0, 0, -0.1 * k], Y)
              for k in range(4)]  # fmt: skip
    joints.append(joint("hinge", "bob", "b3", [0, 0, -0.4], Y))
    mode = np.sqrt(12.0 * 9.81 / (1e-3 * 0.1))
    for scene, fastest in ((four_bar(coupler), 7.5), (case(string, joints), mode)):
        plan = prepare(to_system({"run": {"t_end": 10.0, "every": 10.0}, **scene})).plan
        dt = plan.groups[0].segments[0].dt
        assert 0.05 / (1.5 * fastest) < dt < 0.05 / (0.7 * fastest)


@pytest.mark.compiled
@pytest.mark.slow
@pytest.mark.parametrize("coupler", [1e-6, 1e6])
def test_masses_far_apart_keep_their_energy_over_many_steps(coupler):
    with moved(four_bar(coupler), 10.0, 1e-3, "rattle8", every=0.5) as trajectory:
        drift = np.abs(np.array(trajectory.ledger.energy_error)).max()
    assert drift < 1e-11 * 9.81 * max(coupler, 1.0)


@pytest.mark.parametrize("name", [*SCENES, "odd"])
def test_joints_hold_in_every_frame(name):
    scene = ODD_JOINTS if name == "odd" else SCENES[name]()
    fields = ["position", "orientation", "linear_momentum", "angular_momentum"]
    output = {"fields": [*fields, "velocity", "angular_velocity"]}
    with moved({**scene, "output": output}, 0.1, 0.004, every=0.013) as trajectory:
        g, rate = misfits(trajectory, scene["joint"])
    assert g < 1e-13
    assert rate < 1e-12


def pulled():
    """Two jointed rods and a free block with forces of every kind that has a potential."""
    bodies = [
        bar("a", [0, 0, 0], [1, 0, 0]),
        bar("b", [1, 0, 0], [1, 1, 0]),
        body("free", 2.0, [0.1, 0.2, 0.3], [0.5, -1.0, -1.0]),
    ]
    joints = [joint("ball", "a"), joint("universal", "b", "a", [1, 0, 0], Z, axis_to=Y)]
    force = [
        {"type": "push", "body": "b", "at": [0.3, 0, 0.1], "force": [0, 3.0, 1.0]},
        {"type": "spring", "body": "b", "at": [0.5, 0, 0], "to": "free", "stiffness": 20.0},
        {"type": "spring", "body": "a", "at": [0.2, 0, 0], "anchor": [0, 0, 1.0],
         "stiffness": 15.0},
        {"type": "field", "body": "a", "field": [1.0, 0, 0], "dipole": [0, 0.5, 0.0]},
    ]  # fmt: skip
    return case(bodies, joints, force=force, attraction={"G": 0.5, "softening": 0.3})


@pytest.mark.plain
def test_forces_with_a_potential_act_on_jointed_bodies_at_order_two():
    errors, ends = [], []
    for dt in (0.01, 0.005, 0.0025):
        with moved(pulled(), 0.4, dt, every=0.04) as trajectory:
            errors.append(np.abs(trajectory.ledger.energy_error).max())
            ends.append(np.array(trajectory.position)[-1])
            assert np.abs(trajectory.ledger.angular_momentum_error).max() < 1e-13
    coarse, fine = (np.abs(ends[k] - ends[k + 1]).max() for k in (0, 1))
    assert coarse / fine == pytest.approx(4.0, rel=0.05)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.1)


def free_linkage():
    """Three bodies in a ring of hinge, ball and distance that fly and turn."""
    spin = np.array([0.4, -0.3, 1.0])
    drift = np.array([0.5, 0.2, -0.1])

    def at(place):
        return drift + np.cross(spin, place)

    bodies = [
        bar("a", [0, 0, 0], [1, 0, 0], 1.0, 0.1, at([0.5, 0, 0]), spin),
        bar("b", [1, 0, 0], [1, 1, 0.2], 2.0, 0.1, at([1, 0.5, 0.1]), spin),
        bar("c", [1, 1, 0.2], [0, 1, 0], 0.5, 0.1, at([0.5, 1, 0.1]), spin),
    ]
    joints = [
        joint("hinge", "b", "a", [1, 0, 0], Z),
        joint("ball", "c", "b", [1, 1, 0.2]),
        joint("distance", "c", "a", [0, 1, 0], at_to={"body": [-0.5, 0.0, 0.0]}),
    ]
    return {"body": bodies, "joint": joints}


@pytest.mark.plain
def test_free_linkages_keep_both_momenta():
    with moved(free_linkage(), 1.0, 0.01, every=0.1) as trajectory:
        x, p = np.array(trajectory.position), np.array(trajectory.linear_momentum)
        spin = np.array(trajectory.angular_momentum)
    P, L = p.sum(axis=1), (spin + np.cross(x, p)).sum(axis=1)
    assert np.abs(P - P[0]).max() < 1e-13 * np.linalg.norm(p[0], axis=1).sum()
    assert np.abs(L - L[0]).max() < 1e-13 * np.linalg.norm(L[0])


def reversed_at_end(scene, trajectory):
    """The scene from the end of a trajectory on, with all velocities turned round."""
    state = {
        "position": trajectory.position, "orientation": trajectory.orientation,
        "velocity": -np.array(trajectory.velocity),
        "angular_velocity": -np.array(trajectory.angular_velocity),
    }  # fmt: skip
    bodies = [
        table | {key: np.array(values)[-1, b].tolist() for key, values in state.items()}
        for b, table in enumerate(scene["body"])
    ]
    x0 = np.array(trajectory.position)[0]
    q0, own = np.array(trajectory.orientation)[0], [table["name"] for table in scene["body"]]

    def in_body(table, key, name, is_point):
        if key not in table or isinstance(table[key], dict) or name is None:
            return {}
        b = own.index(name)
        turned = turned_back(q0[b], np.array(table[key]) - (x0[b] if is_point else 0.0))
        return {key: {"body": turned.tolist()}}

    joints = []
    for table in scene["joint"]:
        table = {"at_to": table["at"]} | table  # noqa: PLW2901
        joints.append(
            table | in_body(table, "at", table["body"], True)
            | in_body(table, "at_to", table.get("to"), True)
            | in_body(table, "axis", table["body"], False)
            | in_body(table, "axis_to", table.get("to"), False)
        )  # fmt: skip
    return {**scene, "body": bodies, "joint": joints}


def turned_back(q, v):
    """Rᵀ v."""
    w, u = q[0], -q[1:]
    return v + 2 * w * np.cross(u, v) + 2 * np.cross(u, np.cross(u, v))


def tumbling(w):
    """Four bars in a loop that nothing holds, which turn at w [rad/s] as one body."""
    pins = np.array([[0, 0, 0], [0.5, 0.8, 0], [1.6, 1.0, 0], [1.5, 0, 0]])
    ends = np.roll(pins, -1, axis=0)
    v = np.cross(w, 0.5 * (pins + ends) - pins.mean(axis=0))
    bars = [bar(f"b{k}", pins[k], ends[k], 1.0, 0.1, v[k], w) for k in range(4)]
    return case(bars, [joint("hinge", f"b{k}", f"b{k - 1}" if k else "b3", pins[k], Z)
                       for k in range(4)], (0.0, 0.0, 0.0))  # fmt: skip


@pytest.mark.plain
def test_a_plane_linkage_tumbles_through_planes_of_the_world(monkeypatch):
    """Which of the rows along x, y and z are redundant changes as it turns: none need rest.

    Its plane turns by 0.07 rad a step: a row of which sin 0.01 is in it at one end of a step, and
    sin 0.08 at the other, would be of no use to find impulses.
    """
    rests = []
    monkeypatch.setattr(solver, "_pass_singular_pose", lambda *_: rests.append(1))
    with moved(tumbling([2.0, 3.0, 1.0]), 1.0, 0.02, every=0.1) as trajectory:
        assert joint_loads(trajectory).misfit.max() < 1e-13
        assert np.abs(trajectory.ledger.angular_momentum_error).max() < 1e-13
        assert np.abs(trajectory.ledger.energy_error).max() < 4e-4
    assert not rests


@pytest.mark.compiled
@pytest.mark.slow
@pytest.mark.parametrize("method", ORDERS)
@pytest.mark.parametrize("name", ["mixed_chain", "odd", "bricard"])
def test_ten_thousand_steps_are_undone_by_as_many(name, method):
    scene = ODD_JOINTS if name == "odd" else SCENES[name]()
    fields = ["position", "orientation", "linear_momentum", "angular_momentum"]
    scene = {**scene, "output": {"fields": [*fields, "velocity", "angular_velocity"]}}
    t, dt = 0.5, 0.5e-4
    with moved(scene, t, dt, method) as there:
        start = np.array(there.position)[0]
        back = reversed_at_end(scene, there)
    with moved(back, t, dt, method) as again:
        assert np.abs(np.array(again.position)[-1] - start).max() < 1e-10


def point_pendulum():
    shape = {"type": "points", "position": [[0.0, 0.0, 0.0]], "mass": [1.0]}
    point = {"name": "bob", "shape": shape, "position": [-1.0, 0.0, 0.0]}
    rod = {"type": "distance", "body": "bob", "at_to": [0.0, 0.0, 0.0]}
    return case([point], [rod])


def test_a_pendulum_follows_elliptic_functions():
    """sin(θ/2) = k sn(K - ω₀ t | k²) from rest at 90 degrees, k² = 1/2."""
    with moved(point_pendulum(), 1.0, 0.0125, "rattle8", every=0.25) as trajectory:
        t, x = trajectory.time, np.array(trajectory.position)[:, 0]
    w, m = mpmath.sqrt(9.81), mpmath.mpf(1) / 2
    for time, place in zip(t, x, strict=True):
        half = mpmath.asin(mpmath.sqrt(m) * mpmath.ellipfun("sn", mpmath.ellipk(m) - w * time, m=m))
        exact = [-float(mpmath.sin(2 * half)), 0.0, -float(mpmath.cos(2 * half))]
        assert place == pytest.approx(exact, abs=1e-9)


@pytest.mark.plain
@pytest.mark.parametrize("root", [-1.0, 1.0])
def test_a_gyroscope_precesses_steadily_in_both_ways(root):
    """A Ω² cos θ - C ω₃ Ω + M g l = 0, slow and fast: Goldstein, Classical Mechanics, 5.7."""
    arm, cosine, spin = 0.2, np.cos(1.0), 80.0
    A, C, weight = 0.02 + arm * arm, 0.01, 9.81 * arm
    turning = (C * spin + root * np.sqrt((C * spin) ** 2 - 4 * A * cosine * weight)) / (
        2 * A * cosine
    )
    axis = np.array([np.sin(1.0), 0.0, cosine])
    w = turning * np.array(Z) + (spin - turning * cosine) * axis
    q = [np.cos(0.5), 0.0, np.sin(0.5), 0.0]
    top = body("top", 1.0, [0.02, 0.02, C], arm * axis, np.cross(w, arm * axis), w, q)
    with moved(case([top], [joint("ball", "top")]), 0.25, 2.5e-3, "rattle8") as trajectory:
        x = np.array(trajectory.position)[-1, 0]
    angle = turning * 0.25
    exact = [np.sin(1.0) * np.cos(angle), np.sin(1.0) * np.sin(angle), cosine]
    assert x == pytest.approx(arm * np.array(exact), abs=1e-11)


def test_a_pendulum_keeps_the_energy_that_the_benchmark_asks_for():
    """IFToMM A01: 10 s, 5e-5 J."""
    with moved(point_pendulum(), 1.0, 1e-3, every=0.05) as trajectory:
        x, p = np.array(trajectory.position)[:, 0], np.array(trajectory.linear_momentum)[:, 0]
    energy = 0.5 * (p * p).sum(axis=1) + 9.81 * x[:, 2]
    assert np.abs(energy).max() < 5e-5


def in_the_plane_of_x_and_y(source):
    """A case in the plane of x and z, turned about x, with steps of 10 ms."""

    def turned(v):
        return [v[0], v[2], -v[1]]

    bodies = [b | {k: turned(b[k]) for k in ("position", "velocity", "angular_velocity") if k in b}
              | {"shape": b["shape"] | {"inertia": [b["shape"]["inertia"][k] for k in (0, 2, 1)]}}
              for b in source["body"]]  # fmt: skip
    joints = [j | {k: turned(j[k]) for k in ("at", "axis")} for j in source["joint"]]
    gravity = {"acceleration": turned(source["gravity"]["acceleration"])}
    run = source["run"] | {"dt": 0.01}
    return source | {"run": run, "body": bodies, "joint": joints, "gravity": gravity}


@pytest.mark.slow
def test_a_linkage_passes_the_pose_in_which_all_its_links_are_in_one_line():
    """IFToMM A02: at order 2; all links turn as one."""
    source = tomllib.loads((CASES / "four_bar.toml").read_text())
    del source["check"]
    inertia, weight = 3.0 / 3.0 + 2.0, (3.0 / 2.0 + 2.0) * 9.81
    rate = weight / inertia
    begin = [mpmath.pi / 2, -1]
    motion = mpmath.odefun(lambda _, y: [y[1], -rate * mpmath.cos(y[0])], 0, begin)
    angle = float(motion(1.0)[0])
    missed = []
    for dt in (0.01, 0.005):
        source["run"] = {"t_end": 1.0, "every": 0.25, "dt": dt, "method": "rattle"}
        with particlerb.run(source) as trajectory:
            x = 2.0 * trajectory.position[-1, 0]
            assert np.abs(trajectory.position[-1, :3, 2] - 0.5 * np.sin(angle)).max() < 5e-4
        missed.append(np.hypot(x[0] - np.cos(angle), x[2] - np.sin(angle)))
    assert missed[1] < 2.5e-4
    assert missed[0] / missed[1] == pytest.approx(4.0, abs=0.3)
    with particlerb.run(in_the_plane_of_x_and_y(source)) as trajectory:
        assert particlerb.joint_loads(trajectory).misfit.max() < 1e-13


@pytest.mark.plain
@pytest.mark.parametrize("ahead", [0.04, 0.07, 0.11])
def test_a_composition_passes_that_pose_with_its_energy(ahead):
    """Stages go forth and back through it: with too few rows at rest links locked, or ran astray.

    All links stand `ahead` of the line [rad], as fast as those of IFToMM A02 are there.
    """
    angle, g = np.pi / 2 - ahead, 9.81
    rate = np.sqrt(1.0 + 3.5 * g / 1.5 * (1.0 - np.cos(angle)))
    s, c, q = np.sin(angle), np.cos(angle), (np.cos(angle / 2), 0, np.sin(angle / 2), 0)
    speed, spin = np.array([rate * c, 0, -rate * s]), [0, rate, 0]
    links = [body(f"l{k}", 1.0, [1 / 12, 1 / 12, 1e-3], [k + s / 2, 0, c / 2], speed / 2, spin, q)
             for k in range(3)]  # fmt: skip
    bars = [body(f"b{k}", 1.0, [1e-3, 1 / 12, 1 / 12], [k + 0.5 + s, 0, c], speed)
            for k in range(2)]  # fmt: skip
    tops = ((0, 0), (0, 1), (1, 1), (1, 2))
    joints = [joint("hinge", f"l{k}", None, [k, 0, 0], Y) for k in range(3)]
    joints += [joint("hinge", f"b{i}", f"l{k}", [k + s, 0, c], Y) for i, k in tops]
    with moved(case(links + bars, joints), 0.035, 5e-3, "rattle6") as trajectory:
        energy = trajectory.observable("kinetic_energy")
        error = trajectory.observable("energy_error")[-1]
    assert abs(error) < 1e-3 * energy[0]


@pytest.mark.plain
@pytest.mark.parametrize(("method", "ahead"), [("rattle6", 0.021), ("rattle8", 0.0225)])
def test_a_parallelogram_stays_one_as_it_folds(method, ahead):
    """In one line two branches meet: its cranks turn alike, or against each other.

    Both cranks stand `ahead` of the line [rad], and turn at 3 rad/s; no force acts.
    """
    w, angle = 3.0, np.pi - ahead
    pin, foot = np.array([np.cos(angle), np.sin(angle), 0]), np.array([2.0, 0, 0])
    v = w * np.cross(Z, pin)
    bars = [bar("a", 0 * pin, pin, 1.0, 0.1, v / 2, [0, 0, w]),
            bar("b", foot, foot + pin, 1.0, 0.1, v / 2, [0, 0, w]),
            bar("c", pin, foot + pin, 1.0, 0.1, v)]  # fmt: skip
    joints = [joint("hinge", "a", None, 0 * pin, Z), joint("hinge", "b", None, foot, Z)]
    joints += [joint("hinge", "c", "a", pin, Z), joint("hinge", "c", "b", foot + pin, Z)]
    with moved(case(bars, joints, (0, 0, 0)), 0.02, 5e-3, method) as trajectory:
        x, error = trajectory.position[-1, 2], trajectory.observable("energy_error")[-1]
    angle += 0.02 * w
    assert np.abs(x - [1 + np.cos(angle), np.sin(angle), 0]).max() < 1e-7
    assert abs(error) < 1e-5


def test_equal_mechanisms_of_several_joints_move_alike():
    """Bit for bit, and as one alone."""
    links = hinge_chain(3, 0.3)

    def many(n):
        bodies = [b | {"count": n, "position": [b["position"]] * n} for b in links["body"]]
        return {**links, "body": bodies}

    with moved(many(4), 0.02, 2e-3) as trajectory, moved(links, 0.02, 2e-3) as alone:
        x = np.array(trajectory.position)[-1].reshape(3, 4, 3)
        assert (x == np.array(alone.position)[-1][:, None]).all()


FAR = np.array([1e6, -2e6, 5e5])


def far_away(scene):
    """A scene where places are rounded to 2e-10 m."""
    bodies = [b | {"position": (b["position"] + FAR).tolist()} for b in scene["body"]]
    at = ("at", "at_to")
    joints = [j | {k: (j[k] + FAR).tolist() for k in at if k in j} for j in scene["joint"]]
    return scene | {"body": bodies, "joint": joints}


@pytest.mark.plain
@pytest.mark.parametrize(
    ("name", "method"), [("mixed_chain", "rattle"), ("slider_crank", "rattle6")]
)
def test_loops_hold_far_from_the_origin(name, method):
    scene, places = SCENES[name](), []
    for moves_there, offset in ((scene, 0.0), (far_away(scene), FAR)):
        with moved(moves_there, 0.12, 0.01, method) as trajectory:
            places.append(np.array(trajectory.position)[-1] - offset)
            assert particlerb.joint_loads(trajectory).misfit.max() < (
                1e-8 if np.any(offset) else 1e-13
            )
    assert np.abs(places[1] - places[0]).max() < 1e-8


@pytest.mark.plain
def test_a_loop_that_no_impulse_keeps_is_not_torn_far_from_the_origin():
    scene, w = under_tension(1e-4)
    h = 2.5 / w
    with pytest.raises(RunError, match="too long for the tension of joint"):
        moved(far_away(scene), 40 * h, h).close()


def under_tension(push):
    """Two light rods that carry T: their middle oscillates with w² = 3 T/(m l). Scene and w."""
    m, load = 0.01, 10.0
    rods = [
        bar("upper", [0, 0, 0], [0, 0, -1], m, 0.01, [0.5 * push, 0, 0], [0, -push, 0]),
        bar("lower", [0, 0, -1], [0, 0, -2], m, 0.01, [0.5 * push, 0, 0], [0, push, 0]),
    ]
    weight = body("weight", load, [1.0, 1.0, 1.0], [0, 0, -2])
    joints = [
        joint("hinge", "upper", None, [0, 0, 0], Y),
        joint("ball", "lower", "upper", [0, 0, -1]),
        joint("ball", "lower", "weight", [0, 0, -2]),
        joint("slider", "weight", None, [0, 0, -2], Z),
    ]
    return case([*rods, weight], joints), np.sqrt(3 * 9.81 * (load + m) / m)


@pytest.mark.plain
@pytest.mark.parametrize(("share", "stays"), [(1.99, True), (2.01, False)])
def test_a_tension_mode_is_stable_up_to_the_limit_of_leapfrog(share, stays):
    push = 1e-4
    scene, w = under_tension(push)
    h = share / w
    if not stays:
        with pytest.raises(RunError, match="too long for the tension of joint"):
            moved(scene, 120 * h, h)
        return
    with moved(scene, 300 * h, h, every=h) as trajectory:
        away = np.abs(np.array(trajectory.position)[:, 0, 0])
    assert away.max() == pytest.approx(0.5 * push / w / np.sqrt(1 - 0.25 * share**2), rel=0.1)
