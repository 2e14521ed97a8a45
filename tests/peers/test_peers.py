"""The adapters to other engines: right equations, declared order, bodies in their places.

The reference is SciPy's DOP853 at a tolerance of 1e-13 on Euler's equations in the rotor frame,
written here apart from the adapters, one body at a time.
"""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import particlerb
from benchmarks.peers import ENGINES
from benchmarks.peers.scene import Push, Result, Scene
from particlerb.case.reader import load
from particlerb.case.to_system import to_system
from particlerb.studies.peers import peer_scene

ORDER = {
    ("mujoco", "Euler"): 1,
    ("mujoco", "implicitfast"): 1,
    ("mujoco", "RK4"): 4,
    ("pybullet", "btMultiBody"): 1,
    ("pybullet", "btRigidBody"): 1,
    ("lammps", "rigid/nve/small"): 2,
    ("lammps", "rigid/small"): 2,
    ("scipy", "DOP853"): None,
    ("scipy", "DOP853 world"): None,
    ("scipy", "LSODA"): None,
    ("rebound", "BS"): None,
    ("rebound", "BS world"): None,
}
STEPS = {1: (0.02, 0.01, 0.005), 2: (0.02, 0.01, 0.005), 4: (0.08, 0.04, 0.02)}
TOLERANCES = (1e-4, 1e-7, 1e-10)


def scene(*bodies: dict, gravity=(0.0, 0.0, 0.0), pushes=(), t_end=5.0) -> Scene:
    """Scene of bodies with defaults."""
    start = {
        "mass": 1.0,
        "position": (0, 0, 0),
        "orientation": (1, 0, 0, 0),
        "velocity": (0, 0, 0),
        "angular_velocity": (0.5, 0.7, 0.6),
    }
    rows = [start | body for body in bodies]
    names = ("mass", "inertia", *list(start)[1:])
    arrays = {name: np.array([row[name] for row in rows], dtype=float) for name in names}
    loads = tuple(Push(b, np.array(at, float), np.array(f, float)) for b, at, f in pushes)
    return Scene(**arrays, gravity=np.array(gravity, float), pushes=loads, t_end=t_end)


def tilted(angle: float) -> Rotation:
    """Turn about the world's x axis."""
    return Rotation.from_rotvec([angle, 0, 0])


FREE = scene({"inertia": (1, 2, 3)})
TILT = tilted(np.pi / 6)
TOP = scene(
    {
        "inertia": (1, 1, 0.5),
        "orientation": TILT.as_quat(scalar_first=True),
        "angular_velocity": TILT.apply([0, 0, 3]),
    },
    pushes=[(0, (0, 0, 1), (0, 0, -1)), (0, (0, 0, 0), (0, 0, 1))],
)
PAIR = scene(
    {
        "inertia": (1.0, 1.8, 2.2),
        "mass": 2.0,
        "position": (5, 0, 1),
        "velocity": (1, 2, 3),
        "orientation": Rotation.from_rotvec([0.3, -0.8, 0.5]).as_quat(scalar_first=True),
    },
    {
        "inertia": (2.0, 1.5, 0.9),
        "mass": 0.5,
        "position": (-3, 2, 0),
        "velocity": (0, -1, 0.5),
        "angular_velocity": (-0.4, 0.1, 0.9),
    },
    gravity=(0.1, 0.0, -2.0),
    pushes=[
        (1, (0.3, -0.2, 0.4), (0.2, 0.5, 0.3)),
        (0, (0.5, 0.1, -0.3), (-0.4, 0.6, 0.9)),
        (0, (-0.2, 0.3, 0.1), (0.3, 0.3, -0.5)),
    ],
    t_end=3.0,
)


def reference(scene: Scene) -> Result:
    """Integrate each body by itself; its centre moves on a parabola."""
    ends = []
    for b, inertia in enumerate(scene.inertia):
        pushes = [(p.at, p.force) for p in scene.pushes if p.body == b]

        def slope(t, y, pushes=pushes, inertia=inertia):
            q, w = y[:4], y[4:]
            back = Rotation.from_quat(q, scalar_first=True).inv()
            torque = sum((np.cross(at, back.apply(f)) for at, f in pushes), np.zeros(3))
            dq = 0.5 * np.array([-q[1:] @ w, *(q[0] * w + np.cross(q[1:], w))])
            return np.concatenate([dq, (torque - np.cross(w, inertia * w)) / inertia])

        turn = Rotation.from_quat(scene.orientation[b], scalar_first=True)
        start = np.append(scene.orientation[b], turn.inv().apply(scene.angular_velocity[b]))
        done = solve_ivp(slope, (0, scene.t_end), start, "DOP853", rtol=1e-13, atol=1e-13)
        q, w, t = done.y[:4, -1], done.y[4:, -1], scene.t_end
        R = Rotation.from_quat(q, scalar_first=True)
        force = sum((f for _, f in pushes), np.zeros(3)) + scene.mass[b] * scene.gravity
        v = scene.velocity[b] + t * force / scene.mass[b]
        x = scene.position[b] + 0.5 * t * (v + scene.velocity[b])
        energy = 0.5 * scene.mass[b] * v @ v + 0.5 * inertia @ w**2
        ends.append((x, R.as_quat(scalar_first=True), R.apply(inertia * w), energy))
    return Result(0.0, *(np.array(column) for column in zip(*ends, strict=True)))


@pytest.fixture(params=ORDER, ids="-".join)
def engine(request):
    """Module of an engine and one of its variants; skipped where the engine cannot be used."""
    name, variant = request.param
    module = ENGINES[name]()
    if why := module.missing():
        pytest.skip(why)
    return module, variant, ORDER[request.param]


def angles(a: Result, b: Result) -> np.ndarray:
    """Angles between the orientations of two results, whatever the signs of quaternions [rad]."""
    turns = [Rotation.from_quat(r.orientation, scalar_first=True) for r in (a, b)]
    return (turns[0].inv() * turns[1]).magnitude()


def errors(engine, scene: Scene) -> np.ndarray:
    """Largest errors of angle, L, kinetic energy and position, one row per step or tolerance."""
    module, variant, order = engine
    assert module.refusal(scene) is None
    speed = np.linalg.norm(scene.angular_velocity, axis=1).max()
    steps = [h / speed for h in STEPS[order]] if order else TOLERANCES
    right, rows = reference(scene), []
    for step in steps:
        found = module.run(scene, variant, step)
        assert found.seconds > 0
        rows.append(
            [
                angles(found, right).max(),
                np.abs(found.angular_momentum - right.angular_momentum).max(),
                np.abs(found.kinetic_energy - right.kinetic_energy).max(),
                np.abs(found.position - right.position).max(),
            ]
        )
    return np.array(rows)


@pytest.mark.parametrize("case", [FREE, TOP], ids=["free", "top"])
def test_error_falls_with_the_declared_order(engine, case):
    found, order = errors(engine, case), engine[2]
    if order is None:
        assert (found[:, :3] < 1e3 * np.array(TOLERANCES)[:, None]).all()
    else:
        falls = np.log2(found[:-1, 0] / found[1:, 0])
        assert falls == pytest.approx(order, abs=0.15)
        assert (found[-1, :3] < 0.1).all()


def test_positions_in_gravity_are_of_the_method_s_order(engine):
    case = scene(
        {"inertia": (1, 2, 2.5), "mass": 3.0, "position": (1, 2, 3), "velocity": (1, -2, 4)},
        gravity=(0.0, 1.0, -9.81),
    )
    position, order = errors(engine, case)[:, 3], engine[2]
    if order == 1:
        assert np.log2(position[:-1] / position[1:]) == pytest.approx(1, abs=0.01)
    else:
        assert (position < 1e-10).all()


def test_two_bodies_with_pushes_beside_the_centre_keep_their_order(engine):
    found = errors(engine, PAIR)
    order = engine[2]
    if order is None:
        assert (found < 1e3 * np.array(TOLERANCES)[:, None]).all()
    else:
        assert np.log2(found[:-1, 0] / found[1:, 0]) == pytest.approx(order, abs=0.15)
        assert (found[-1] < 0.1).all()


def test_grains_of_a_milligram_turn_like_bodies_of_a_kilogram(engine):
    module, variant, order = engine
    mass, length = 1e-6, 1e-3
    small = PAIR._replace(
        mass=mass * PAIR.mass,
        inertia=mass * length**2 * PAIR.inertia,
        position=length * PAIR.position,
        velocity=length * PAIR.velocity,
        gravity=length * PAIR.gravity,
        pushes=tuple(Push(b, length * p, mass * length * f) for b, p, f in PAIR.pushes),
    )
    step = 0.05 if order else 1e-6
    found, large = module.run(small, variant, step), module.run(PAIR, variant, step)
    assert angles(found, large).max() < 1e-6
    assert found.position / length == pytest.approx(large.position, abs=1e-9)
    assert found.kinetic_energy / (mass * length**2) == pytest.approx(large.kinetic_energy)


@pytest.mark.parametrize("case", [FREE, TOP], ids=["free", "top"])
def test_engines_with_the_same_explicit_step_agree_to_rounding(case):
    engines = [ENGINES[name]() for name in ("mujoco", "pybullet")]
    if why := engines[0].missing() or engines[1].missing():
        pytest.skip(why)
    ends = [engines[0].run(case, "Euler", 0.02), engines[1].run(case, "btMultiBody", 0.02)]
    assert angles(*ends).max() < 1e-11
    assert ends[0].angular_momentum == pytest.approx(ends[1].angular_momentum, abs=1e-11)


NEEDLE = scene({"inertia": (1, 1, 0.02), "angular_velocity": (0.3, 0.2, 3.0)}, t_end=500.0)


def test_a_step_too_long_neither_raises_nor_warns_nor_writes_a_file(
    engine, tmp_path, monkeypatch, capfd
):
    module, variant, order = engine
    monkeypatch.chdir(tmp_path)
    found = module.run(NEEDLE, variant, 0.5 if order else 1e-2)
    assert found.orientation.shape == (1, 4)
    assert list(tmp_path.iterdir()) == []
    assert "unstable" not in "".join(capfd.readouterr())


ROD = scene({"inertia": (2, 0, 2), "angular_velocity": (0.5, 0, 0.6)})


@pytest.mark.parametrize("name", ENGINES)
def test_a_rod_turns_about_its_momentum_or_is_refused_in_a_sentence(name):
    module = ENGINES[name]()
    if why := module.missing():
        pytest.skip(why)
    if name == "textbook":
        assert "there are none" in module.refusal(ROD)
        return
    if module.refusal(ROD) is not None:
        assert "body 0 is a rod" in module.refusal(ROD)
        assert name in {"mujoco", "pybullet"}
        return
    turn = Rotation.from_rotvec(5.0 * ROD.angular_velocity[0])
    for variant in module.VARIANTS:
        found = module.run(ROD, variant, 1e-9 if module.ADAPTIVE else 0.005)
        axis = Rotation.from_quat(found.orientation[0], scalar_first=True).apply([0, 1, 0])
        assert axis == pytest.approx(turn.apply([0, 1, 0]), abs=1e-4)


@pytest.mark.parametrize(
    ("name", "case", "words"),
    [
        ("mujoco", scene({"inertia": (0, 0, 0)}), "body 0 is a point"),
        ("lammps", scene({"inertia": (0, 0, 0)}), "body 0 is a point"),
        ("lammps", scene({"inertia": (1, 2, 3)}, pushes=[(0, (0, 0, 1), (1, 0, 0))]), "plane"),
        ("lammps", scene({"inertia": (1, 1, 3)}), "one exceeds the sum"),
        ("scipy", scene({"inertia": (2, 0, 2)}, pushes=[(0, (1, 0, 0), (0, 0, 1))]), "beside"),
        ("rebound", scene({"inertia": (0, 0, 0)}, pushes=[(0, (1, 0, 0), (0, 0, 1))]), "beside"),
    ],
)
def test_what_an_engine_cannot_hold_is_said_in_a_sentence(name, case, words):
    assert words in ENGINES[name]().refusal(case)


def test_points_come_back_after_a_period_of_their_orbit():
    """Two points of masses 3 and 1, a = 1, e = 0.3 and G = 1: they start at the pericentre."""
    pytest.importorskip("rebound")
    rebound = ENGINES["rebound"]()
    speed, part = np.sqrt(4.0 * 1.3 / 0.7), np.array([-0.25, 0.75])
    bodies = [
        {
            "inertia": (0, 0, 0),
            "mass": m,
            "position": (0.7 * s, 0, 0),
            "velocity": (0, speed * s, 0),
        }
        for m, s in zip((3.0, 1.0), part, strict=True)
    ]
    orbit = scene(*bodies, t_end=2.0 * np.pi / np.sqrt(4.0))._replace(attraction=(1.0, 0.0))
    for variant, bound in (("IAS15", 1e-12), ("BS", 1e-8)):
        found = rebound.run(orbit, variant, 1e-9)
        assert np.abs(found.position - orbit.position).max() < bound, variant
    softened = rebound.run(orbit._replace(attraction=(1.0, 0.1)), "IAS15", 1e-9)
    assert np.abs(softened.position - orbit.position).max() > 0.01


@pytest.mark.plain
def test_springs_pull_as_ours_do(make):
    """Between tilted boxes and the world, beside the centres, damped, in gravity, with a push."""
    box = {"type": "box", "size": [0.4, 0.3, 0.2], "arrangement": "exact"}
    turn = {"euler_deg": [20, -40, 60]}
    bodies = [
        {"name": "a", "shape": box, "mass": 2.0, "orientation": turn, "velocity": [0.1, 0.2, 0]},
        {
            "name": "b",
            "shape": box,
            "mass": 1.0,
            "position": [0.8, 0.1, 0],
            "angular_velocity": [1, 2, 3],
        },
    ]
    spring = {"type": "spring", "body": "a", "stiffness": 40.0, "damping": 0.7}
    force = [
        spring | {"at": [0.1, 0.05, 0.1], "to": "b", "to_at": [-0.2, 0, 0.1], "rest_length": 0.5},
        spring | {"at": [-0.2, 0.1, 0], "anchor": [-0.5, 0, 0.4], "rest_length": "initial"},
        make.push([0.1, 0, 0.1], [0.5, 1.0, 0], body="b"),
    ]
    case = make.case(*bodies, force=force, t_end=0.3, every=0.3, method="rk4", dt=2e-3,
                     gravity={"acceleration": [0, 1.0, -9.81]})  # fmt: skip
    ours = particlerb.run(case)
    given = peer_scene(to_system(load(case)))
    found = ENGINES["scipy"]().run(given, "DOP853", 1e-10)
    assert np.abs(found.position - ours.position[-1]).max() < 1e-8
    L = np.abs(found.angular_momentum - ours.angular_momentum[-1]).max()
    assert L < 1e-8
