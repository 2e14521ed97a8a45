"""Gears, racks and screws: closed forms, conservation, orders, and what is refused."""

import numpy as np
import pytest
from scenes import X, Y, Z, body, case, joint
from scipy.spatial.transform import Rotation

import particlerb
from particlerb import CaseError, RunError, joint_loads
from particlerb.case.to_system import to_system
from particlerb.model.bodies import quaternions
from particlerb.simulation.run import prepare

METHODS = {
    "rattle": {"dt": 0.01},
    "rattle6": {"dt": 0.05},
    "dop853": {"tolerance": 1e-12},
}
TURNING = {"output": {"fields": ["position", "orientation", "linear_momentum", "angular_momentum",
                                 "angular_velocity", "velocity",
                                 "joint_coordinate"]}}  # fmt: skip

IN_PLAIN_PYTHON = [pytest.param(name, marks=pytest.mark.plain) for name in METHODS]


def moved(scene, t, method, every, **keys):
    """Trajectory of a scene until t, by a method with its usual step or another."""
    times = {"t_end": t, "every": every, "method": method} | (keys or METHODS[method])
    return particlerb.run({"run": times, **scene, **TURNING})


def two_gears(teeth=(20, 40), **keys):
    """Wheels on axes of the world, 0.3 m apart; 2 and 3 kg m² about them."""
    bodies = [body("a", 1, [1, 1, 2], [0, 0, 0]), body("b", 2, [2, 2, 3], [0.3, 0, 0])]
    joints = [
        joint("hinge", "a", None, [0, 0, 0], Z),
        joint("hinge", "b", None, [0.3, 0, 0], Z),
        {"type": "gear", "body": "a", "to": "b", "axis": Z, "teeth": list(teeth)},
    ]
    return case(bodies, joints, (0, 0, 0), **keys)


@pytest.mark.parametrize("method", IN_PLAIN_PYTHON)
@pytest.mark.parametrize("teeth", [(20, 40), (20, -50)])
def test_two_gears_turn_by_the_ratio_of_their_teeth(teeth, method):
    """α = τ/(I_a + I_b ρ²), and the force of a tooth is I_b |α_b|/r_b; ρ = z_a/z_b."""
    torque = {"type": "torque", "body": "a", "torque": [0, 0, 1.5]}
    with moved(two_gears(teeth, force=[torque]), 4.0, method, 1.0) as trajectory:
        spin, loads = np.array(trajectory.angular_velocity)[:, :, 2], joint_loads(trajectory)
        t = trajectory.time
    ratio = teeth[0] / teeth[1]
    rate = 1.5 / (2 + 3 * ratio**2)
    assert spin == pytest.approx(np.outer(rate * t, [1.0, -ratio]), abs=1e-12)
    radius = abs(0.3 * teeth[1] / sum(teeth))
    force = np.linalg.norm(loads.force[:, 2], axis=1)
    assert force == pytest.approx(3 * rate * abs(ratio) / radius, rel=1e-9)


def planetary(sun_on_carrier=False):
    """Sun on a carrier's axis, a planet on the carrier, a ring in the world; 24, 18 and 60 teeth.

    A tooth is 2π/600 m wide.
    """
    arm = (24 + 18) / 600
    bodies = [
        body("sun", 1, [0.01, 0.01, 0.02], [0, 0, 0], spin=[0, 0, 7]),
        body("carrier", 1, [0.02, 0.02, 0.03], [0, 0, 0], spin=[0, 0, 2]),
        body("planet", 0.5, [0.001, 0.001, 0.002], [arm, 0, 0], [0, 2 * arm, 0],
             [0, 0, 2 - 60 / 18 * 2]),
    ]  # fmt: skip
    joints = [
        joint("hinge", "sun", "carrier" if sun_on_carrier else None, [0, 0, 0], Z),
        joint("hinge", "carrier", None, [0, 0, 0], Z),
        joint("hinge", "planet", "carrier", [arm, 0, 0], Z),
        {"type": "gear", "body": "sun", "to": "planet", "axis": Z, "teeth": [24, 18]},
        {"type": "gear", "body": "planet", "at_to": [0, 0, 0], "axis": Z, "teeth": [18, -60]},
    ]
    return case(bodies, joints, (0, 0, 0))


@pytest.mark.parametrize("method", ["rattle6", *IN_PLAIN_PYTHON[::2]])
def test_a_planetary_gear_goes_by_the_equation_of_willis(method):
    """ω_sun = (1 + z_ring/z_sun) ω_carrier; nothing acts, so all spins stay."""
    with moved(planetary(), 2.0, method, 0.5) as trajectory:
        spin = np.array(trajectory.angular_velocity)[:, :, 2]
        place = np.array(trajectory.position)[:, 2]
        t = trajectory.time
    assert spin == pytest.approx(np.tile([7, 2, 2 - 60 / 18 * 2], (t.size, 1)), abs=1e-11)
    arm = (24 + 18) / 600
    exact = arm * np.stack([np.cos(2 * t), np.sin(2 * t)], axis=1)
    phase = (2 * 0.01) ** 2 / 24 * 2 * t.max()  # of order two, on a circle
    assert np.abs(place[:, :2] - exact).max() < (2 * arm * phase if method == "rattle" else 1e-11)


@pytest.mark.parametrize("method", IN_PLAIN_PYTHON)
@pytest.mark.parametrize("lead", [0.2, -0.5])
def test_a_nut_sinks_along_its_screw(lead, method):
    """z̈ = -g/(1 + I/(m p²)), p = lead/2π; θ = z/p."""
    scene = case([body("nut", 2, [0.2, 0.2, 0.3], [0, 0, 1])],
                 [joint("screw", "nut", None, [0, 0, 1], Z, lead=lead)])  # fmt: skip
    with moved(scene, 2.0, method, 0.5) as trajectory:
        z, w = np.array(trajectory.position)[:, 0, 2], np.array(trajectory.angular_velocity)
        coordinate, t = np.array(trajectory.joint_coordinate), trajectory.time
    p = lead / (2 * np.pi)
    sunk = -0.5 * 9.81 / (1 + 0.3 / (2 * p * p)) * t * t
    assert z == pytest.approx(1 + sunk, abs=1e-12)
    assert w[:, 0, 2] * p * t == pytest.approx(2 * sunk, abs=1e-12)
    assert coordinate == pytest.approx(np.stack([sunk, sunk / p], axis=1), abs=1e-11)


@pytest.mark.parametrize("method", IN_PLAIN_PYTHON)
def test_a_wheel_rolls_down_a_rack(method):
    """ẍ = g sin α/(1 + I/(m r²)) on a slope of the world."""
    slope, r = 0.3, 0.25
    down = np.array([np.cos(slope), 0, -np.sin(slope)])
    up = np.array([np.sin(slope), 0, np.cos(slope)])
    joints = [
        joint("planar", "wheel", None, [0, 0, 0], Y),
        joint("slider", "frame", None, [0, 0, 0], down.tolist()),
        joint("hinge", "wheel", "frame", [0, 0, 0], Y),
        joint("rack", "wheel", None, [0, 0, 0], Y, axis_to=down.tolist(),
              at_to=(-r * up).tolist()),
    ]  # fmt: skip
    bodies = [body("wheel", 2, [0.04, 0.08, 0.04], [0, 0, 0]),
              body("frame", 0.5, [0.1, 0.1, 0.1], [0, 0, 0])]  # fmt: skip
    with moved(case(bodies, joints), 1.0, method, 0.25) as trajectory:
        path = np.array(trajectory.position)[:, 0] @ down
        w, t = np.array(trajectory.angular_velocity)[:, 0, 1], trajectory.time
    rate = 2.5 * 9.81 * np.sin(slope) / (2.5 + 0.08 / r**2)
    assert path == pytest.approx(0.5 * rate * t * t, abs=1e-12)
    assert w * r == pytest.approx(rate * t, abs=1e-12)


def rack_and_pinion(**keys):
    """A pinion on a hinge, 0.5 kg m² about it, and a bar of 3 kg on a slider, 0.2 m apart."""
    bodies = [body("pinion", 1, [1, 1, 0.5], [0, 0, 0]), body("bar", 3, [1, 1, 1], [0, -0.2, 0])]
    joints = [
        joint("hinge", "pinion", None, [0, 0, 0], Z),
        joint("slider", "bar", None, [0, -0.2, 0], X),
        joint("rack", "pinion", "bar", [0, 0, 0], Z, axis_to=X, at_to=[0, -0.2, 0]),
    ]
    return case(bodies, joints, (0, 0, 0), **keys)


@pytest.mark.plain
def test_a_rack_is_pushed_by_its_pinion():
    """τ = I α + m r² α, and the force of a tooth is m r α; to the side of the pitch line."""
    force = [{"type": "torque", "body": "pinion", "torque": [0, 0, 1.0]}]
    with moved(rack_and_pinion(force=force), 3.0, "rattle", 1.0) as trajectory:
        x, t = np.array(trajectory.position)[:, 1, 0], trajectory.time
        loads = joint_loads(trajectory)
    rate = 1.0 / (0.5 + 3 * 0.2**2)
    assert x == pytest.approx(0.5 * 0.2 * rate * t * t, abs=1e-12)
    assert loads.force[:, 2, 0] == pytest.approx(-3 * 0.2 * rate, rel=1e-9)


def turned(scene, R, shift):
    """A scene turned and shifted as a whole."""
    (q,), at = quaternions(R[None]), {"position", "at", "at_to"}
    own = [b | {"orientation": q.tolist()} for b in scene["body"]]
    motion = {"angular_velocity", "velocity", "axis", "axis_to"}

    def moved_table(table):
        vectors = {k: (R @ table[k]).tolist() for k in motion & table.keys()}
        return table | vectors | {k: (R @ table[k] + shift).tolist() for k in at & table.keys()}

    own = [moved_table(b | ({"motion": moved_table(b["motion"])} if "motion" in b else {}))
           for b in own]  # fmt: skip
    return scene | {"body": own, "joint": [moved_table(j) for j in scene["joint"]]}


@pytest.mark.plain
@pytest.mark.parametrize("method", ["rattle", "dop853"])
@pytest.mark.parametrize("kind", ["gear", "rack"])
def test_a_wheel_in_mesh_with_a_driven_body_begins_where_it_is_placed(kind, method):
    """It turns by what the other side does; whatever the attitude of the whole, to rounding."""
    wheel = body("wheel", 1, [1, 1, 2], [0.3, 0, 0], spin=(0, 0, -4.5))
    other = body("driven", 1, [1, 1, 2], [0, 0, 0]) | {"motion": {"angular_velocity": [0, 0, 2.25]}}
    teeth = {"type": "gear", "teeth": [20, 40]}
    if kind == "rack":
        other |= {"motion": {"velocity": [0, 0.9, 0]}, "position": [0.1, -0.5, 0]}
        teeth = {"type": "rack", "axis_to": Y, "at_to": [0.1, 0, 0]}
    joints = [joint("hinge", "wheel", None, [0.3, 0, 0], Z)]
    joints.append({"body": "wheel", "to": "driven", "axis": Z, **teeth})
    R = Rotation.from_rotvec([0.7, -1.1, 0.4]).as_matrix()
    scene = turned(case([wheel, other], joints, (0, 0, 0)), R, np.array([0.3, -1.7, 0.9]))
    times = {"dt": 0.01} if method == "rattle" else {"tolerance": 1e-9}
    with moved(scene, 1.0, method, 0.25, **times) as trajectory:
        q = np.array(trajectory.orientation)[0, 0]
        assert abs(q @ scene["body"][0]["orientation"]) == pytest.approx(1.0, abs=1e-13)
        coordinate = np.array(trajectory.joint_coordinate)[:, 0]
        assert coordinate == pytest.approx(-4.5 * trajectory.time, abs=1e-12)


def floating(kind):
    """A housing in free space that tumbles; on it two gears, a rack or a nut, out of balance."""
    n, at, off = np.array(Z), np.array([0.3, 0.0, 0.1]), 0.05 * np.array(X)
    first = {"housing": 0 * n, "a": 0.1 * n}  # of each body the point about which it turns,
    turns, slides = {"a": 6 * n}, {}
    if kind == "gear":
        first["b"], turns["b"] = at, -3 * n
        joints = [joint("hinge", "a", "housing", 0.1 * n, Z), joint("hinge", "b", "housing", at, Z)]
        joints.append(joint("gear", "a", "b", 0.1 * n, Z, at_to=at.tolist(), teeth=[20, 40]))
    elif kind == "rack":
        first["b"], slides["b"] = np.array([0, -0.2, 0.1]), 6 * 0.2 * np.array(X)
        joints = [
            joint("hinge", "a", "housing", 0.1 * n, Z),
            joint("slider", "b", "housing", at, X),
        ]
        joints.append(joint("rack", "a", "b", 0.1 * n, Z, axis_to=X, at_to=[0, -0.2, 0.1]))
    else:
        slides["a"] = 6 * 0.4 / (2 * np.pi) * n
        joints = [joint("screw", "a", "housing", 0.1 * n, Z, lead=0.4)]
    spin, bodies = np.array([0.4, 0.9, 1.5]), []
    for name, point in first.items():
        place, own = point + (0 if name == "housing" else off), turns.get(name, 0 * n)
        velocity = np.cross(spin, place) + np.cross(own, place - point) + slides.get(name, 0)
        moments = {"housing": [1, 1.5, 2], "a": [0.1, 0.1, 0.15], "b": [0.2, 0.3, 0.4]}[name]
        bodies.append(body(name, 1, moments, place, velocity, spin + own))
    return case(bodies, joints, (0, 0, 0))


@pytest.mark.plain
@pytest.mark.parametrize("kind", ["gear", "rack", "screw"])
def test_what_rolls_on_a_housing_that_tumbles(kind):
    """Momenta to rounding, orders 2 and 6; dop853, from second derivatives, has the same motion."""
    ends = {}
    for method, dt in (("rattle", 0.02), ("rattle", 0.01), ("rattle6", 0.05), ("rattle6", 0.025),
                       ("dop853", None)):  # fmt: skip
        with moved(floating(kind), 1.0, method, 0.25, **({"dt": dt} if dt else {})) as trajectory:
            ends[method, dt] = np.array(trajectory.position)[-1]
            ledger, rounding = trajectory.ledger, 1e-13 if dt else 1e-11
        assert np.abs(ledger.linear_momentum_error).max() < rounding
        assert np.abs(ledger.angular_momentum_error).max() < rounding
        assert np.abs(ledger.energy_error).max() < (1e-3 if dt else 1e-10)
    best = ends["dop853", None]
    error = {key: np.abs(end - best).max() for key, end in ends.items()}
    assert error["rattle", 0.02] / error["rattle", 0.01] == pytest.approx(4, rel=0.1)
    assert error["rattle6", 0.025] < 1e-8
    assert error["rattle6", 0.05] / error["rattle6", 0.025] > 30


@pytest.mark.plain
@pytest.mark.parametrize("kind", ["gear", "rack", "screw"])
def test_what_teeth_carry_changes_the_momentum(kind):
    """Forces on a body beside differences of order 6 of its momentum, 2 ms apart."""
    with moved(floating(kind), 0.036, "dop853", 0.002) as trajectory:
        a, p = trajectory.names.index("a"), np.array(trajectory.linear_momentum)
        loads = joint_loads(trajectory)
    of_a = [k for k, name in enumerate(loads.names) if name.startswith("a-")]
    force = loads.force[:, of_a].sum(axis=1)[3:-3]
    weights = np.array([-1, 9, -45, 0, 45, -9, 1]) / 60 / 0.002
    rate = sum(w * p[k : len(p) - 6 + k, a] for k, w in enumerate(weights))
    assert force == pytest.approx(rate, abs=1e-7 * np.abs(rate).max())


@pytest.mark.plain
def test_whole_turns_of_gears_need_no_count():
    """500 steps in which teeth go on by 0.8 of their pitch each."""
    scene = two_gears()
    turn = 2 * np.pi * 0.8 / 20
    for one, ratio in zip(scene["body"], (1.0, -0.5), strict=True):
        one["angular_velocity"] = [0, 0, ratio * turn / 0.01]
    with moved(scene, 5.0, "rattle", 5.0) as trajectory:
        spin = np.array(trajectory.angular_velocity)[-1, :, 2]
    assert spin == pytest.approx([turn / 0.01, -0.5 * turn / 0.01], rel=1e-13)


@pytest.mark.plain
@pytest.mark.parametrize("torque", [100.0, 300.0])
def test_teeth_that_are_pushed_over_some_in_a_step_hold(torque):
    """Without the other wheel, a would turn by torque h²/4, some of the 20 teeth."""
    force = [{"type": "torque", "body": "a", "torque": [0, 0, torque]}]
    with moved(two_gears(force=force), 0.2, "rattle", 0.2, dt=0.1) as trajectory:
        turn = np.array(trajectory.joint_coordinate)[-1]
    assert turn == pytest.approx(0.02 * torque / 2.75 * np.array([1, -0.5]), rel=1e-9)


@pytest.mark.plain
def test_a_step_in_which_teeth_are_passed_ends_the_run():
    force = [{"type": "torque", "body": "a", "torque": [0, 0, 1e4]}]
    with pytest.raises(RunError, match="joint a-b no longer rolls: in a step teeth"):
        moved(two_gears(force=force), 1.0, "rattle", 0.5, dt=0.1)


@pytest.mark.plain
@pytest.mark.parametrize("lead", [1e-4, 1e-6])
def test_a_nut_on_a_fine_thread_does_not_fall(lead):
    scene = case([body("nut", 2, [0.2, 0.2, 0.3], [0, 0, 1])],
                 [joint("screw", "nut", None, [0, 0, 1], Z, lead=lead)])  # fmt: skip
    with moved(scene, 1.0, "rattle", 1.0) as trajectory:
        turn = np.array(trajectory.joint_coordinate)[-1, 1]
    p = lead / (2 * np.pi)
    assert turn == pytest.approx(-0.5 * 9.81 * p / (p * p + 0.15), rel=1e-5)


@pytest.mark.plain
def test_a_plate_sinks_on_two_screws_that_turn():
    """A loop whose redundant rows turn with the screws: a = -g m/(m + 2 I (2π/lead)²)."""
    bodies = [body("plate", 2, [0.1, 0.1, 0.1], [0, 0, 0])]
    bodies += [body(f"s{k}", 1, [0.02, 0.02, 0.01], [k - 0.5, 0, 0]) for k in range(2)]
    joints = []
    for k in range(2):
        at = [k - 0.5, 0, 0]
        joints += [joint("hinge", f"s{k}", None, at, Z),
                   joint("screw", "plate", f"s{k}", at, Z, lead=0.1)]  # fmt: skip
    with moved(case(bodies, joints), 1.0, "rattle6", 1.0, dt=0.05) as trajectory:
        z = np.array(trajectory.position)[-1, 0, 2]
    assert z == pytest.approx(-9.81 / (2 + 2 * 0.01 * (20 * np.pi) ** 2), abs=1e-11)


@pytest.mark.plain
@pytest.mark.parametrize("method", ["rattle", "dop853"])
@pytest.mark.parametrize("pair", ["gear", "rack"])
def test_axes_that_tilt_once_they_are_released_end_the_run(pair, method):
    scene = two_gears() if pair == "gear" else rack_and_pinion()
    for hinge in scene["joint"][:2]:
        hinge["during"] = [0, 0.1]
    torque = {"type": "torque", "body": scene["body"][0]["name"], "torque": [0.5, 0.3, 0.2]}
    times = {"t_end": 2.0, "every": 0.5, "method": method} | METHODS[method]
    with pytest.raises(RunError, match=r"no longer rolls: its axes have left their place"):
        particlerb.run({"run": times, **scene, "force": [torque]})


@pytest.mark.plain
@pytest.mark.parametrize(
    ("pair", "other", "words"),
    [
        ("gear", None, "tilt"),
        ("gear", {"type": "ball"}, "tilt"),
        ("gear", {"type": "universal", "axis": Z, "axis_to": Y}, "tilt"),
        ("gear", {"type": "planar", "axis": Z}, "move apart"),
        ("rack", {"type": "planar", "axis": Z}, "move apart"),
        ("rack", {"type": "cylindrical", "axis": X}, "tilt"),
    ],
)
def test_axes_that_nothing_holds_are_named_by_the_plan(pair, other, words):
    """The last joint but one is replaced, of two gears, and of a rack and its pinion."""
    scene = two_gears() if pair == "gear" else rack_and_pinion()
    scene["joint"][1:2] = [] if other is None else [{**scene["joint"][1], "axis": None} | other]
    scene["joint"] = [{k: v for k, v in one.items() if v is not None} for one in scene["joint"]]
    with pytest.raises(CaseError, match=f"does not roll: its axes may .*{words}"):
        prepare(to_system({"run": {"t_end": 1, "every": 1, "dt": 0.01}, **scene}))


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"teeth": [20, 0]}, "teeth"),
        ({"teeth": 20}, r"(?s)must be a list of 2 numbers.*teeth = \[20, 40\]"),
        ({"teeth": [20, -20]}, "negative one at most, of a ring"),
        ({"teeth": None}, "a gear joint needs one"),
        ({"lead": 0.1}, "a gear joint has none"),
        ({"at_to": [0, 0, 0.5]}, "has no pitch radius"),
        ({"type": "rack", "teeth": None, "axis_to": [0, 1, 0]}, "a point of the pitch line"),
        ({"type": "rack", "teeth": None, "axis_to": [0, 1, 1], "at_to": [0.3, 0, 0]},
         "is not across `axis`"),
        ({"type": "screw", "teeth": None, "lead": 0.0}, "must not be 0"),
        ({"type": "gear", "spring": {"stiffness": 1.0}}, "nothing acts along a gear joint"),
    ],
)  # fmt: skip
def test_what_cannot_roll_is_refused_by_name(keys, message):
    scene = two_gears()
    gear = scene["joint"][2] | keys
    scene["joint"][2] = {key: value for key, value in gear.items() if value is not None}
    with pytest.raises(CaseError, match=message):
        particlerb.run({**scene, "run": {"t_end": 0.1, "every": 0.1, "dt": 0.01}})
