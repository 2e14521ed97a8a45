"""Variants in one batch: each has the bits of a run alone, its own drift, its own failure."""

import numpy as np
import pytest

from particlerb import CaseError
from particlerb.case.changes import likeness
from particlerb.case.problems import path_of
from particlerb.case.reader import load
from particlerb.case.sweep import SweepTable
from particlerb.case.to_system import to_system
from particlerb.contact.missed_pairs import Watch
from particlerb.forces import attraction
from particlerb.model.worlds import WorldsDifferError, bins_of, over_all, over_bodies, worlds_among
from particlerb.plan import group_terms
from particlerb.plan.make_plan import make_plan
from particlerb.sweeping import worker
from particlerb.sweeping.together import may_share, rows_together
from particlerb.sweeping.variants import variants
from particlerb.sweeping.worker import Task, batch_of, work

BOX = {"type": "box", "size": [0.4, 0.6, 1.0], "n": [2, 2, 2]}
PUSH = {"type": "push", "body": "body", "at": [0.1, 0.2, 0.0], "force": [0.0, 0.0, 5.0]}
DRAG = {"type": "drag", "body": "body", "translation": 0.3, "rotation": 0.1}
ANCHOR = {
    "type": "spring",
    "body": "body",
    "at": [0.1, 0, 0.2],
    "anchor": [0, 0, 2],
    "stiffness": 50.0,
}
CENTRE = {"type": "central", "body": "body", "centre": [3.0, 0.0, 0.0], "mu": 2.0}
IMPULSE = {
    "type": "impulse",
    "body": "body",
    "at": [0, 0.1, 0],
    "impulse": [0.2, 0, 0],
    "time": 0.017,
}
TORQUE = {"type": "torque", "body": "body", "torque": [0.3, 0.0, 0.1], "frame": "body"}
TIED = [
    {"type": "spring", "body": "body", "to": "other", "at": [0.1, 0.0, 0.0], "stiffness": 30.0,
     "damping": 0.2, "rest_length": "initial"},
    {"type": "spring", "body": "other", "anchor": [0.0, 0.0, 3.0], "stiffness": 20.0,
     "damping": 0.1},
]  # fmt: skip
ASKED = [
    {"body": "body", "quantity": "position"},
    {"body": "body", "quantity": "orientation"},
    {"body": "body", "quantity": "kinetic_energy"},
    {"body": "body", "quantity": "angular_velocity", "frame": "body", "time": 0.013},
    {"body": "body", "quantity": "inertia"},
]
MASS = {"body.0.mass": [1.0, 2.5, 3.0]}
SPIN = {"body.0.angular_velocity": [[0.5, 1, 2], [1, 2, 0.3], [0.2, 5, 1]]}
NEAR = {"body.0.angular_velocity": [[0.5, 1, 2], [1e-3, 5, 1e-3]]}
RATE = {"force.0.translation": [0.1, 0.5, 0.9]}


def scene(*forces, method="strang", dt=2e-3, gravity=True, others=(), **body) -> dict:
    """A box under forces."""
    moving = {"angular_velocity": [1.0, 2.0, 0.5], "velocity": [0.1, 0.2, 0.3]}
    run = {"t_end": 0.03, "every": 0.01, "method": method} | ({"dt": dt} if dt else {})
    own = {"name": "body", "shape": BOX, "mass": 2.0} | moving | body
    falls = {"gravity": {"acceleration": [0.1, 0.0, -9.81]}} if gravity else {}
    return {"run": run, "body": [own, *others], "force": list(forces)} | falls


def pair(*forces) -> dict:
    """The same, tied to a symmetric body that hangs on a spring."""
    other = {"name": "other", "mass": 1.5, "position": [1.0, 0.0, 0.0]}
    other["shape"] = {"type": "moments", "inertia": [1.0, 2.0, 2.0]}
    return scene(*TIED, *forces, others=[other])


def top(**run) -> dict:
    """A top of Lagrange."""
    shape = {"type": "moments", "inertia": [15.0, 0.5, 15.0]}
    weight = {"type": "push", "body": "body", "at": [0.0, 1.0, 0.0], "force": [0.0, 0.0, -147.0]}
    case = scene(weight, shape=shape, angular_velocity={"body": [0.0, 150.0, -4.6]}, gravity=False)
    case["run"] = {"t_end": 0.02, "every": 0.01} | run
    return case


def touching(*bodies, contact=(), wall=(), t_end=0.02) -> dict:
    """Bodies that touch each other and walls, under gravity."""
    law = {"law": "hooke", "stiffness": 1e5} if "law" not in contact else {}
    law |= {"restitution": 0.6, "friction": 0.3, "overlap": 2e-3}
    return {
        "run": {"t_end": t_end, "every": 0.01, "method": "strang", "dt": 2e-4},
        "gravity": {"acceleration": [0.0, 0.3, -9.81]},
        "contact": law | dict(contact),
        "body": list(bodies),
        "wall": list(wall),
    }


def ball(name, *position, velocity=(0.0, 0.0, 0.0), **more) -> dict:
    """A ball of radius 0.1 m."""
    shape = {"type": "sphere", "radius": 0.1}
    moving = {"position": list(position), "velocity": list(velocity)}
    return {"name": name, "shape": shape, "mass": 1.0} | moving | more


FLOOR = {"name": "floor", "type": "plane", "normal": [0, 0, 1]}
ROOM = {"name": "room", "type": "box", "lower": [-0.1, -0.1, 0.0], "upper": [0.4, 0.2, 0.4]}
TRIO = (
    ball("body", 0.0, 0.0, 0.0999, velocity=(2.0, 0.1, 0.0)),
    ball("other", 0.21, 0.0, 0.0999),
    ball("third", 0.105, 0.02, 0.27, velocity=(0.0, 0.0, -0.5)),
)
CORNER = (
    ball("body", 0.0, 0.0, 0.0999, velocity=(0.5, -0.2, 0.0)),
    ball("other", 0.2, 0.05, 0.2, velocity=(-1.0, 0.4, -0.3)),
)
ENDS = {"type": "spheres", "radius": [0.1, 0.1, 0.08], "position": [[0, 0, 0], [0.1, 0, 0],
        [0.05, 0.1, 0]]}  # fmt: skip
SPINNING = {"angular_velocity": [1.0, 2.0, 5.0]}
CLUMPS = (
    {"name": "body", "shape": ENDS, "mass": 1.0, "position": [0.0, 0.0, 0.0999]} | SPINNING,
    {"name": "other", "shape": ENDS, "mass": 2.0, "position": [0.05, 0.02, 0.297]} | SPINNING,
    ball("post", 0.25, 0.02, 0.15, fixed=True),
)
MATERIAL = {"material": [{"name": "steel", "young": 1e7, "poisson": 0.3}]}
TWO = {"material": [{"name": "steel"}, {"name": "wood"}]}
WOOD = {"material": "wood"}
OF_TWO = [TRIO[0] | WOOD, TRIO[1] | {"material": "steel"}, TRIO[2] | WOOD]
PAIR = {"pair": [{"materials": ["steel", "wood"], "friction": 0.5}]}
SHAKEN = ROOM | {"motion": {"oscillation": {"amplitude": [0, 0, 0.01], "frequency": 20.0}}}
RADII = {"body.0.shape.radius": [0.1, 0.0999, 0.0998]}
HERTZ = {"law": "hertz", "rolling_friction": 0.01}
FRICTION = {"contact.friction": [0.1, 0.25, 0.7]}
OF_PAIR = FRICTION | {"contact.pair.0.friction": [0.3, 0.6, 0.2]}
SPEEDS = {"body.0.velocity": [[2.0, 0.1, 0.0], [9.0, 0.3, 0.1], [0.5, 2.0, 0.0]]}
LAW = {"contact.stiffness": [1e5, 3e5], "contact.restitution": [0.4, 0.9]}
DRAWN = {
    "count": 5, "velocity": {"random": 1.0}, "orientation": "random",
    "place": {"type": "random", "lower": [0, 0, 0], "upper": [5, 5, 5]},
}  # fmt: skip
GRID = {"count": 300, "place": {"type": "grid", "spacing": 2.0}}
BALL = {"shape": {"type": "moments", "inertia": [2.0, 2.0, 2.0]}}
SHORT = {"t_end": 0.02, "every": 0.02, "method": "strang", "dt": 1e-2}
LATER = PUSH | {"during": [0.0, 0.013]}
WEIGHTS = {"force.0.force": [[0.0, 0.0, -9.0], [0.0, 0.0, 5.0]]}
PLACES = {"body.1.position": [[1.0, 0.1, 0.2], [2.0, 0.5, 0.3]]}
TURNS = [[0.1, 0.7, 0.2, 0.4], [0.5, -0.5, 0.3, 0.1], {"euler_deg": [10, 20, 30]}]
ALONG = {"angular_velocity": [0.0, 2.0, 0.0], "velocity": [0.0, 0.0, 0.4]}
UP = {"gravity": {"acceleration": [0.0, 0.0, -9.81]}}
ABOUT = {"type": "torque", "body": "body", "torque": [0.0, 0.3, 0.0]}
ACROSS = PUSH | {"at": [0.1, 0.0, 0.2]}
HUNG = ANCHOR | {"at": [0.0, 0.0, 0.0], "damping": 0.7}
BOUND = {"type": "spring", "body": "body", "to": "other", "stiffness": 30.0}
FREE = {"name": "other", "mass": 1.5, "position": [1.0, 0.0, 0.0], "shape": BOX}
CLOSED = {
    "pendulum": (scene(ACROSS, method="auto", dt=None, **ALONG), MASS),
    "torque and drag": (scene(ABOUT, DRAG, method="auto", dt=None, **ALONG), MASS),
    "damped on a line": (scene(HUNG, method="auto", dt=None, **ALONG) | UP, MASS),
    "springs and drag": (scene(HUNG | {"damping": 0.0}, DRAG | {"rotation": 0.0}, method="auto",
                               dt=None), MASS),
    "pair on a spring": (scene(BOUND, method="auto", dt=None, others=[FREE]), MASS),
}  # fmt: skip
"""Those that are moved in closed form by what is known from the start, or by damped springs."""
FORCES = """
import particlerb
from particlerb.maths.vec3 import dot, scale, subtract

def energy(x1, x2, q1, q2, k):
    d = subtract(x2, x1)
    return k * q1 * q2 / dot(d, d) ** 0.5

@particlerb.force(potential=energy)
def coulomb(x1, x2, q1, q2, k):
    d = subtract(x2, x1)
    r2 = dot(d, d)
    return scale(-k * q1 * q2 / (r2 * r2**0.5), d), (0.0, 0.0, 0.0)

@particlerb.force
def wind(v, c, t):
    return scale(-c * (1.0 + t), v), (0.0, 0.0, 0.0)
"""
CHARGES = {"q1": [1.0, 2.0, 0.5], "q2": [1.0, 2.0, 0.5]}
MINE = {"type": "python", "file": "mine.py", "body": ["body", "other", "third"]}
COULOMB = MINE | {"function": "coulomb", "reach": 9.0, "parameters": {"k": 2.0},
                  "per_body": CHARGES}  # fmt: skip
WIND = MINE | {"function": "wind", "per_body": {"c": [1.0, 2.0, 0.5]}}
AMONG = {"type": "spring", "body": ["body", "other", "third"], "reach": 1.9, "stiffness": 30.0,
         "rest_length": "initial"}  # fmt: skip
PIVOT = {"name": "pivot", "type": "hinge", "body": "body", "at": [-0.5, 0, 0], "axis": [0, 1, 0],
         "assemble": True}  # fmt: skip
ELBOW = {"name": "elbow", "type": "hinge", "body": "other", "to": "body", "at": [0.5, 0, 0],
         "axis": [0, 1, 0], "spring": {"stiffness": 3.0}, "damper": 0.2,
         "assemble": True}  # fmt: skip
CHAIN = {"name": "rope", "type": "ball", "body": ["body", "other", "third"], "chain": True,
         "assemble": True}  # fmt: skip
WELD = {"type": "fixed", "body": "other", "to": "body", "assemble": True}
BREAKS = {"name": "pin", "type": "ball", "body": "third", "breaks_at": {"force": 14.0},
          "assemble": True}  # fmt: skip
SIZES = {"body.0.shape": [{"type": "box", "size": [0.5, 0.6, 0.7], "n": n} for n in (2, 3, 4)]}
PULL = {"attraction": {"G": 3.0, "softening": 0.01}}
OF_THIRD = [{"body": "third", "quantity": "position"}]
AT_ELBOW = [
    {"joint": "elbow", "quantity": "joint_coordinate", "time": 0.013},
    {"joint": "elbow", "quantity": "joint_force"},
]


def three(*forces, joint=(), method="strang", **more) -> dict:
    """Two boxes, and between them in the order of the case a symmetric body."""
    other = {"name": "other", "mass": 1.0, "position": [1.1, 0.0, 0.0], "velocity": [0.0, 0.3, 0.0]}
    other["shape"] = {"type": "moments", "inertia": [1.0, 2.0, 2.0]}
    third = {"name": "third", "mass": 1.5, "shape": BOX, "position": [0.0, 1.7, 0.2]}
    case = scene(*forces, method=method, others=[other, third], gravity=bool(joint)) | more
    return case | ({"joint": list(joint)} if joint else {})


COUPLED = {
    "joints": (three(joint=[PIVOT, ELBOW], method="rattle"), MASS, AT_ELBOW),
    "joints and drag": (three(DRAG, joint=[PIVOT, ELBOW], method="rattle"), MASS, AT_ELBOW),
    "a chain of each": (three(joint=[CHAIN], method="rattle"), MASS, []),
    "merged, and one that breaks": (three(joint=[WELD, BREAKS], method="rattle"),
                                    {"body.2.mass": [1.0, 1.5]}, OF_THIRD),
    "attraction": (three(**PULL), MASS, []),
    "attraction and a spring": (three(TIED[0], **PULL), MASS, []),
    "attraction of some": (three(attraction={"G": 3.0, "body": ["body", "third"]}), MASS, []),
    "attraction of sizes that differ": (three(**PULL), SIZES, []),
    "springs by reach": (three(AMONG), MASS, []),
    "forces of users": (three(WIND, COULOMB), MASS, []),
    "a parameter": (three(COULOMB), {"force.0.parameters.k": [1.0, 2.0, 3.0]}, []),
}  # fmt: skip
"""Bodies that act on each other by more than springs and contacts; and what else is asked."""
BATCHES = {
    "free": (scene(method="auto", dt=None), SPIN),
    "free, one world near the separatrix": (scene(method="auto", dt=None, **GRID), NEAR),
    "mass and seed": (scene(DRAG, **DRAWN), MASS | {"run.seed": [0, 7]}),
    "drag, closed": (scene(DRAG | {"rotation": 0.0}, method="auto", dt=None), RATE),
    "kepler, closed": (scene(CENTRE, method="auto", dt=None, gravity=False, **BALL), MASS),
    "top, closed": (top(), MASS),
    "top, strang": (top(method="strang", dt=1e-3), WEIGHTS),
    "top, rk4": (top(method="rk4", dt=1e-3), MASS),
    "all forces": (scene(DRAG, TORQUE, LATER, ANCHOR, CENTRE, IMPULSE), RATE | MASS),
    "rkn6": (scene(ANCHOR, CENTRE, method="rkn6"), MASS),
    "blocks of bodies": (scene(DRAG, ANCHOR, **GRID) | {"run": SHORT}, RATE),
    "springs between": (pair(DRAG), MASS),
    "stiffness": (pair(DRAG), {"force.0.stiffness": [10.0, 25.0, 40.0]}),
    "rest length": (pair(), PLACES),
    "turned": (scene(ANCHOR, velocity={"body": [0.1, 0.2, 0.3]}), {"body.0.orientation": TURNS}),
    "spheres": (touching(*TRIO, wall=[FLOOR]), FRICTION),
    "spheres, fast ones": (touching(*TRIO, wall=[FLOOR]), SPEEDS),
    "spheres, laws": (touching(*TRIO, wall=[FLOOR]), LAW),
    "spheres of several sizes": (touching(*TRIO, wall=[FLOOR]), RADII | MASS),
    "clumps": (touching(*CLUMPS, wall=[FLOOR]), FRICTION),
    "corner of a box": (touching(*CORNER, wall=[ROOM]), SPEEDS),
    "hertz, rolling": (touching(*TRIO, wall=[FLOOR], contact=HERTZ) | MATERIAL, FRICTION),
    "pairs of materials": (touching(*OF_TWO, wall=[FLOOR | WOOD], contact=PAIR) | TWO, OF_PAIR),
    "springs and contact": (touching(*TRIO, wall=[FLOOR]) | {"force": TIED[:1]}, FRICTION),
    "a wall that moves": (touching(*CORNER, wall=[FLOOR, SHAKEN]), SPEEDS),
    "shape and mass": (pair(DRAG), {"body.0.shape.size.1": [0.5, 0.7, 0.9]} | MASS),
}
"""Cases, and axes of their variants."""


def batch(case: dict, axes: dict, asked=()) -> Task:
    """All variants as one task."""
    loaded = load(case, allow_code=True)
    table = SweepTable(axes=axes, value=asked)
    rows = tuple(v.values for v in variants(loaded, table))
    paths = tuple(map(path_of, axes))
    return Task(tuple(range(len(rows))), rows, paths, loaded.source, table.value, True)


@pytest.mark.parametrize("name", BATCHES)
def test_rows_of_a_batch_have_the_bits_of_rows_alone(name):
    task = batch(*BATCHES[name], asked=ASKED)
    assert may_share(to_system(BATCHES[name][0]))
    together = rows_together(task.numbers, batch_of(task), task.asked)
    assert repr(together) == repr(work(task._replace(is_batch=False)))
    assert len({row.values for row in together}) == len(together) > 1
    assert len({row.energy_drift for row in together}) > 1 or name in ("free", "top, closed")


@pytest.mark.plain
@pytest.mark.parametrize("name", CLOSED)
def test_closed_forms_have_the_bits_of_runs_alone_too(name):
    case, axes = CLOSED[name]
    assert all(s.method == "exact" for g in make_plan(to_system(load(case))).groups
               for s in g.segments)  # fmt: skip
    task = batch(case, axes, asked=ASKED)
    assert repr(rows_together(task.numbers, batch_of(task), task.asked)) == repr(
        work(task._replace(is_batch=False))
    )


@pytest.mark.plain
@pytest.mark.parametrize("name", COUPLED)
def test_bodies_of_a_world_act_on_each_other_alone(name, tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text(FORCES)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(attraction, "TILE", 8)  # so that worlds have several, and not all as many
    case, axes, more = COUPLED[name]
    task = batch(case, axes, asked=[*ASKED, *more])
    together = rows_together(task.numbers, batch_of(task), task.asked)
    assert repr(together) == repr(work(task._replace(is_batch=False)))
    assert len({row.values for row in together}) == len(together) > 1
    assert more is not AT_ELBOW or all(row.values[-4] < 0.0 for row in together)  # the angle


@pytest.mark.plain
def test_a_tree_has_all_bodies_of_one_world():
    task = batch(three(attraction={"G": 3.0, "sum": "tree"}), MASS)
    with pytest.raises(WorldsDifferError, match="a tree of all bodies"):
        rows_together(task.numbers, batch_of(task), ())


@pytest.mark.plain
def test_what_sums_the_attraction_is_chosen_for_each_world(monkeypatch):
    """A world alone takes a tree from 8000 particles on: not by the mean of several."""
    monkeypatch.setattr(group_terms, "BREAK_EVEN", 60)
    task = batch(three(**PULL), SIZES)
    with pytest.raises(WorldsDifferError, match="a tree of all bodies"):
        rows_together(task.numbers, batch_of(task), ())


@pytest.mark.plain
def test_worlds_of_which_some_are_off_the_line_run_alone():
    case, _ = CLOSED["damped on a line"]
    task = batch(case, {"body.0.velocity": [[0.0, 0.0, 1.0], [0.0, 1e-9, 1.0]]})
    with pytest.raises(WorldsDifferError, match="closed form"):
        rows_together(task.numbers, batch_of(task), ())


@pytest.mark.plain
@pytest.mark.parametrize(
    ("case", "why"),
    [
        (scene(ANCHOR, CENTRE, method="dop853", dt=None), "chooses steps"),
        (scene(ANCHOR, CENTRE, dt=None), "a step of its own"),
    ],
)
def test_who_steps_by_his_neighbours_runs_alone(case, why):
    task = batch(case, MASS)
    with pytest.raises(WorldsDifferError, match=why):
        rows_together(task.numbers, batch_of(task), ())
    assert work(task) == work(task._replace(is_batch=False))


def test_a_variant_that_fails_in_a_batch_fails_alone():
    case = scene(DRAG)
    case["check"] = {"energy_drift": 1e-30}
    task = batch(case, {"body.0.velocity": [[1, 0, 0], [1e308, 0, 0], [0, 1, 0]]}, ASKED)
    rows = work(task)
    assert [row.status[:6] for row in rows] == ["done", "failed", "done"]
    assert [row.missed for row in rows] == [1, 0, 1]


def test_each_world_misses_its_own_checks():
    """The error of strang grows with the stiffness of a spring: one of three is above the limit."""
    case, axes = scene(ANCHOR), {"force.0.stiffness": [5.0, 5000.0, 4.0]}
    drifts = [row.energy_drift for row in work(batch(case, axes))]
    assert drifts[1] > 10.0 * max(drifts[0], drifts[2])
    case["check"] = {"energy_drift": drifts[1] / 2.0}
    assert [row.missed for row in work(batch(case, axes))] == [0, 1, 0]


def test_worlds_do_not_touch_each_other_and_lists_are_watched(monkeypatch):
    """All worlds lie in one place, and overlap by all of their balls."""
    monkeypatch.setattr(Watch, "is_due", lambda *arguments: True)
    task = batch(touching(*TRIO, wall=[FLOOR]), SPEEDS, ASKED)
    together = rows_together(task.numbers, batch_of(task), task.asked)
    assert repr(together) == repr(work(task._replace(is_batch=False)))


def test_contact_that_goes_wrong_is_found_in_its_own_row():
    """One begins in another ball, one passes through the floor in a step."""
    places = [[0.21, 0.0, 0.0999], [0.1, 0.0, 0.0999], [0.22, 0.0, 0.0999]]
    rows = work(batch(touching(*TRIO, wall=[FLOOR]), {"body.1.position": places}, ASKED))
    assert [row.status[:6] for row in rows] == ["done", "failed", "done"]
    assert "bodies overlap at t = 0: body and other by 0.1 m" in rows[1].status
    speeds = {"body.0.velocity": [[1.0, 0, 0], [0.0, 0, -900.0], [2.0, 0, 0]]}
    rows = work(batch(touching(*TRIO, wall=[FLOOR]), speeds, ASKED))
    assert [row.status[:6] for row in rows] == ["done", "failed", "done"]


def test_each_world_has_the_energy_of_its_own_contacts():
    """The step errs more on stiffer contacts: one of three is above the limit."""
    case, axes = touching(*TRIO, wall=[FLOOR]), {"contact.stiffness": [1e5, 2e6, 1.1e5]}
    drifts = [row.energy_drift for row in work(batch(case, axes))]
    assert drifts[1] > 3.0 * max(drifts[0], drifts[2])
    case["check"] = {"energy_drift": drifts[1] / 2.0}
    assert [row.missed for row in work(batch(case, axes))] == [0, 1, 0]


def test_who_shares_a_batch():
    paths = [path_of(key) for key in ("run.dt", "body.0.mass", "force.0.force", "force.0.time")]
    like = likeness(paths, (1e-3, 1.0, [0.0, 1.0, 2.0], 0.5))
    assert like == likeness(paths, (1e-3, 2.0, [0.0, 3.0, 4.0], 0.5))
    for others in (
        (2e-3, 1.0, [0.0, 1.0, 2.0], 0.5),
        (1e-3, 1.0, [0.1, 1.0, 2.0], 0.5),
        (1e-3, 1.0, [0.0, 1.0, 2.0], 0.6),
    ):
        assert like != likeness(paths, others)
    assert may_share(to_system("bouncing"))
    relaxed = touching(*TRIO, wall=[FLOOR], contact={"relax": True})
    impulses = touching(*TRIO, wall=[FLOOR], contact={"law": "impulse", "overlap": 0.0})
    pressed = touching(*TRIO, wall=[FLOOR | {"piston": {"mass": 1.0, "axis": [0, 0, 1]}}])
    for case in (relaxed, impulses, pressed):
        assert not may_share(to_system(case))


def test_a_batch_falls_back_where_kinds_of_rotors_differ(monkeypatch):
    """A box that becomes a cube is a spherical top, which other kernels turn."""
    axes = {"body.0.shape.size": [[0.4, 0.6, 1.0], [1.0, 1.0, 1.0]]}
    task = batch(scene(ANCHOR), axes, ASKED)
    assert repr(work(task)) == repr(work(task._replace(is_batch=False)))
    monkeypatch.setattr(worker, "rows_together", lambda *a: pytest.fail("shared a batch"))
    work(task._replace(is_batch=False))


def test_what_is_wrong_with_a_body_is_still_told_with_its_name():
    case = scene(others=[{"name": "tiny", "shape": BOX, "mass": 1e-320}])
    task = batch(case, MASS)
    with pytest.raises(CaseError, match=r"tiny: .*too small"):
        rows_together(task.numbers, batch_of(task), ())
    assert all("tiny: " in row.status for row in work(task))


def test_sums_over_worlds_take_bodies_as_one_world_alone_would():
    rng = np.random.default_rng(1)
    values = rng.normal(size=(3, 40)) * 10.0 ** rng.integers(-8, 8, size=40)
    world = np.tile(np.arange(4), 10)
    worlds = worlds_among(world, 4)
    for w in range(4):
        own = np.ascontiguousarray(values[:, world == w])
        assert np.array_equal(over_bodies(values, worlds)[w], own.sum(axis=1))
        assert over_all(values, worlds)[w] == own.sum()
    bins = bins_of(np.arange(10) // 4, worlds)
    assert bins.max() == 11
    assert all(np.array_equal(bins[world == w], 3 * w + np.arange(10) // 4) for w in range(4))
    with pytest.raises(WorldsDifferError):
        worlds_among(world[1:], 4)
