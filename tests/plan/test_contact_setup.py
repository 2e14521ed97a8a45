"""Contact resolved: who touches whom with which numbers, walls, and what starts wrong."""

import itertools
import math
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from particlerb.case.problems import CaseError
from particlerb.case.reader import load, parse
from particlerb.case.to_system import to_case, to_system
from particlerb.contact.wall_motion import PrescribedMotion
from particlerb.contact.walls import DISC, FACE, PLANE, RIM, SIDE
from particlerb.plan.contact_setup import NOTHING, contact_of
from particlerb.plan.make_plan import make_plan
from particlerb.plan.remove_overlaps import remove_overlaps


def contact(case):
    return contact_of(to_system(case))


def problems(case):
    with pytest.raises(CaseError) as caught:
        contact(case)
    return [(p.key, p.reason, p.hint) for p in caught.value.problems]


def only(case):
    (found,) = problems(case)
    return found


def material(name, young=2e11, poisson=0.3):
    return {"name": name, "young": young, "poisson": poisson}


def balls(make, *places, **keys):
    """Balls of radius 0.1 m."""
    return make.sphere("ball", count=len(places), position=np.array(places, dtype=float), **keys)


# Who takes part


def test_without_contact_there_is_none(make):
    assert contact(make.case(make.sphere())) is None


def test_bodies_with_a_radius_take_part_unless_they_say_not(make):
    case = make.case(
        make.sphere("a"),
        make.body("ghost", contact=False),
        make.sphere("b", position=[1, 0, 0], contact=False),
        balls(make, [2, 0, 0], [3, 0, 0], fixed=True),
        contact=make.hooke(),
    )
    found = contact(case)
    assert found.body.tolist() == [0, 3, 4]
    assert found.material.tolist() == [0, NOTHING, NOTHING, 0, 0]
    assert found.fixed.tolist() == [False, False, False, True, True]


def test_a_body_without_radius_is_named_and_told_what_to_do(make):
    parts = [{"shape": {"type": "rod", "length": 1}, "mass": 1}]
    case = make.case(
        make.sphere("a"), make.body("b"), {"name": "c", "part": parts}, contact=make.hooke()
    )
    reason = "no particle has a radius: nothing can touch this body"
    assert [p[:2] for p in problems(case)] == [("body[1].shape", reason), ("body[2].part", reason)]
    assert "take a `ball` without `n`" in problems(case)[0][2]


def test_something_must_be_able_to_touch(make):
    reason = "nothing can touch: this takes two bodies, or a body and a wall, of which one can move"
    two = [make.sphere("a", fixed=True), make.sphere("b", fixed=True, position=[1, 0, 0])]
    for bodies, walls in (
        ([make.sphere()], []),
        (two, []),
        (two, [make.plane()]),
        ([make.sphere(contact=False)], [make.plane()]),
    ):
        case = make.case(*bodies, contact=make.hooke(), wall=walls)
        assert only(case)[:2] == ("contact", reason)
    for bodies, walls in (
        ([balls(make, [0, 0, 1], [0, 0, 2])], []),
        ([make.sphere(position=[0, 0, 1])], [make.plane()]),
        ([two[0], make.sphere("b", position=[1, 0, 0])], []),
    ):
        assert contact(make.case(*bodies, contact=make.hooke(), wall=walls))


# Shapes that touch


def test_a_sphere_is_a_ball_of_one_particle(make):
    """I = 2/5 m R², m = ρ 4/3 π R³."""
    system = to_system(make.case(make.sphere(radius=0.5, mass=None, density=3.0)))
    mass = 3.0 * 4.0 / 3.0 * math.pi * 0.125
    assert system.bodies.mass == pytest.approx(mass, rel=1e-15)
    assert system.bodies.inertia[:, 0] == pytest.approx(0.4 * mass * 0.25, rel=1e-15)
    assert system.particles.radius.tolist() == [0.5]
    again = load(to_case(system).model_dump(mode="json"))
    assert again.body == system.body


def test_a_clump_of_spheres_has_their_inertia_and_radii(make):
    """Eight balls at (±a, ±a, ±a): I = 8 (2/5 m r² + 2 m a²)."""
    corners = [[0.1 * s for s in signs] for signs in itertools.product((-1, 1), repeat=3)]
    shape = {"type": "points", "position": corners, "mass": 1.0, "radius": 0.1}
    system = to_system(make.case({"name": "clump", "shape": shape}))
    assert system.bodies.mass.tolist() == [8.0]
    assert system.bodies.inertia[:, 0] == pytest.approx(8 * (0.4 * 0.01 + 2 * 0.01), rel=1e-15)
    assert system.particles.radius.tolist() == [0.1] * 8


def test_parts_without_mass_are_surface_and_change_no_inertia(make):
    box = {"shape": {"type": "box", "size": [1, 2, 3], "arrangement": "exact"}, "mass": 6.0}
    sphere = {"shape": {"type": "sphere", "radius": 0.2}, "mass": 0, "position": [1, 2, 3]}
    points = {"type": "points", "position": [[1, 0, 0], [0, 5, 0]], "mass": 0, "radius": 0.1}
    case = make.case({"name": "plain", "part": [box]}, {"name": "b", "part": [box, sphere]})
    case["body"].append({"name": "c", "part": [box, {"shape": points}]})
    system = to_system(case)
    assert system.bodies.mass.tolist() == [6.0] * 3
    assert (system.bodies.inertia[:, 0] == system.bodies.inertia.T).all()
    assert system.particles.radius.tolist() == [0.0] * 16 + [0.2] + [0.0] * 8 + [0.1] * 2
    assert system.particles.position[16] == pytest.approx([1, 2, 3], abs=1e-15)
    again = load(to_case(system).model_dump(mode="json"))
    assert again.body == system.body


# Numbers of pairs


def test_one_material_has_the_numbers_of_contact_and_a_default_tangential_stiffness(make):
    case = make.case(make.sphere(), make.sphere("b", position=[1, 0, 0]), contact=make.hooke(7.0))
    found = contact(case)
    asked = found.record
    assert (asked.law, asked.skin) == ("hooke", None)
    assert (asked.attract, asked.relax, asked.allow_unstable) == (False,) * 3
    assert list(found.materials) == [""]
    numbers = {key: float(value[0, 0]) for key, value in found.pairs._asdict().items()}
    assert numbers == {
        "stiffness": 7.0,
        "tangential_stiffness": 2.0,
        "modulus": 0.0,
        "shear_modulus": 0.0,
        "restitution": 0.8,
        "damping_ratio": pytest.approx(0.07435509, rel=1e-6),
        "friction": 0.5,
        "rolling_friction": 0.0,
        "torsional_friction": 0.0,
        "can_meet": 1.0,
    }


def test_flags_and_skin_are_those_of_the_case(make):
    numbers = make.hooke(attract=True, relax=True, allow_unstable=True, skin=0.02)
    found = contact(
        make.case(make.sphere(position=[0, 0, 1]), wall=[make.plane()], contact=numbers)
    )
    asked = found.record
    assert (asked.attract, asked.relax, asked.allow_unstable, asked.skin) == (*(True,) * 3, 0.02)
    decay = -math.log(0.8)  # e = exp(-π ζ / √(1 - ζ²))
    assert found.pairs.damping_ratio[0, 0] == pytest.approx(decay / math.hypot(math.pi, decay))


def test_a_pair_has_its_own_numbers_and_those_of_contact_where_it_gives_none(make):
    pair = {"materials": ["glass", "steel"], "friction": 0.0, "tangential_stiffness": 3.0}
    case = make.case(
        make.sphere("a", material="steel"),
        make.sphere("b", material="glass", position=[1, 0, 0]),
        make.sphere("c", material="glass", position=[2, 0, 0]),
        contact=make.hooke(7.0, rolling_friction=0.01, pair=[pair]),
        material=[{"name": "steel"}, {"name": "wood"}, {"name": "glass"}],
    )
    found = contact(case)
    pairs = found.pairs
    assert found.material.tolist() == [0, 2, 2]
    own = [[0, 0, 1], [0, 0, 0], [1, 0, 1]]  # steel is alone, nothing is of wood
    assert pairs.can_meet.tolist() == np.array(own, dtype=bool).tolist()
    assert pairs.stiffness.tolist() == [[0, 0, 7], [0, 0, 0], [7, 0, 7]]
    assert pairs.tangential_stiffness.tolist() == [[0, 0, 3], [0, 0, 0], [3, 0, 2]]
    assert pairs.friction.tolist() == [[0, 0, 0], [0, 0, 0], [0, 0, 0.5]]
    assert pairs.rolling_friction.tolist() == [[0, 0, 0.01], [0, 0, 0], [0.01, 0, 0.01]]
    assert pairs.restitution.tolist() == [[0, 0, 0.8], [0, 0, 0], [0.8, 0, 0.8]]


def test_only_pairs_that_can_meet_need_numbers(make):
    """Fixed bodies and walls do not touch each other; one body does not touch itself."""
    pair = {"materials": ["a", "b"], "stiffness": 1.0, "restitution": 0.5, "friction": 0.1}
    names = [{"name": name} for name in "abc"]
    bodies = [
        make.sphere("moving", material="a", position=[0, 0, 1]),
        balls(make, [0, 0, 2], [0, 0, 2.1], fixed=True, material="b"),
    ]
    case = make.case(
        *bodies, contact={"pair": [pair]}, material=names, wall=[make.plane(material="b")]
    )
    can_meet = contact(case).pairs.can_meet
    assert np.argwhere(can_meet).tolist() == [[0, 1], [1, 0]]


def test_hertz_has_effective_moduli(make):
    """1/E* = Σ (1 - ν²)/E and 1/G* = Σ (2 - ν)/G with G = E/(2 (1 + ν))."""
    case = make.case(
        make.sphere("a", material="hard"),
        make.sphere("b", material="soft", position=[1, 0, 0]),
        contact={"law": "hertz", "restitution": 0.9, "friction": 0.3},
        material=[material("hard", 4e9, 0.2), material("soft", 1e9, 0.4)],
    )
    pairs = contact(case).pairs
    modulus = 1.0 / (0.96 / 4e9 + 0.84 / 1e9)
    shear = 1.0 / (1.8 * 2.4 / 4e9 + 1.6 * 2.8 / 1e9)
    assert pairs.modulus == pytest.approx(modulus * np.array([[0, 1], [1, 0]]), rel=1e-15)
    assert pairs.shear_modulus == pytest.approx(shear * np.array([[0, 1], [1, 0]]), rel=1e-15)
    assert not pairs.stiffness.any()
    assert pairs.friction[0, 1] == 0.3


def test_a_missing_pair_is_named(make):
    pair = {"materials": ["steel", "steel"], "stiffness": 1.0, "restitution": 0.5, "friction": 0.1}
    case = make.case(
        balls(make, [0, 0, 1], [0, 0, 2], material="steel"),
        contact={"pair": [pair]},
        material=[{"name": "steel"}, {"name": "glass"}],
        wall=[make.plane(material="glass")],
    )
    key, reason, hint = only(case)
    assert key == "contact.pair"
    assert reason == (
        "missing: steel with glass, which can touch, has no"
        " `restitution` and `friction` and `stiffness`"
    )
    assert hint.startswith('add [[contact.pair]] with materials = ["steel", "glass"]')
    pair["materials"] = ["glass", "steel"]
    assert only(case)[1].startswith("missing: steel with itself, which can touch, has no")


def test_a_missing_number_is_shown_in_its_pair(make):
    pair = {"materials": ["glass", "steel"], "stiffness": 1.0, "friction": 0.1}
    case = make.case(
        make.sphere(position=[0, 0, 1], material="steel"),
        contact={"pair": [pair]},
        material=[{"name": "steel"}, {"name": "glass"}],
        wall=[make.plane(material="glass")],
    )
    assert only(case) == (
        "contact.pair[0].restitution",
        "missing: steel with glass needs `restitution`",
        "give it here, or in [contact] for all pairs",
    )


@pytest.mark.parametrize("missing", ["stiffness", "restitution", "friction"])
def test_a_missing_number_of_one_material_is_shown_in_contact(make, missing):
    case = make.case(balls(make, [0, 0, 1], [0, 0, 2]), contact=make.hooke())
    del case["contact"][missing]
    reason = f"missing: contact needs `{missing}`"
    assert only(case) == (f"contact.{missing}", reason, "give it in [contact]")


def test_hertz_needs_young_and_poisson_of_materials_that_touch(make):
    numbers = {"law": "hertz", "restitution": 0.9, "friction": 0.3}
    body = balls(make, [0, 0, 1], [0, 0, 2])
    assert only(make.case(body, contact=numbers)) == (
        "contact.law",
        "hertz needs a [[material]] with `young` and `poisson`",
        'add it, or take law = "hooke"',
    )
    materials = [{"name": "unused"}, {"name": "steel", "young": 1e11}, {"name": "glass"}]
    case = make.case(
        body | {"material": "steel"},
        contact=numbers,
        material=materials,
        wall=[make.plane(material="glass")],
    )
    keys = ["material[1].poisson", "material[2].young", "material[2].poisson"]
    assert [p[0] for p in problems(case)] == keys
    assert {p[1] for p in problems(case)} == {"missing: hertz needs it"}


def test_with_several_materials_each_must_be_named(make):
    case = make.case(
        make.sphere("a", position=[0, 0, 1]),
        make.sphere("b", position=[0, 0, 2], material="steel"),
        make.sphere("c", position=[0, 0, 3], contact=False),
        contact=make.hooke(),
        material=[{"name": "steel"}, {"name": "glass"}],
        wall=[make.plane(), make.plane([0, 0, -1], "lid", point=[0, 0, 4], material="glass")],
    )
    assert problems(case) == [
        ("body[0].material", "missing: there are several", "known: steel, glass"),
        ("wall[0].material", "missing: there are several", "known: steel, glass"),
    ]


def test_all_that_is_wrong_with_contact_is_said_at_once(make):
    case = make.case(make.sphere("a"), make.body("b"), contact={"stiffness": 1.0})
    assert [p[0] for p in problems(case)] == ["body[1].shape", "contact.restitution"]


# Walls


def boxed(name, **keys):
    return {"type": "box", "name": name, "lower": [-9, -9, 0], "upper": [9, 9, 2]} | keys


def drum(name, **keys):
    return {"type": "cylinder", "name": name, "radius": 9, "length": 18} | keys


def test_walls_are_their_primitives_one_after_another(make):
    """The faces of a box are two triangles each; a cylinder has a side, and two ends with rims."""
    walls = [
        make.plane([0, 3e200, 4e200], point=[1, -2, 0]),
        boxed("bin", open=["+z"]),
        drum("drum", axis=[0, 2, 0], open=["-"]),
    ]
    case = make.case(make.sphere(position=[0, 0.5, 1]), wall=walls, contact=make.hooke())
    found = contact(case)
    kinds = [found.walls.kind[found.walls.wall == w].tolist() for w in range(3)]
    assert kinds[0] == [PLANE]
    assert kinds[1].count(FACE) == 10
    assert sorted(kinds[2]) == [SIDE, DISC, RIM, RIM]
    assert found.walls.parameter[0, :6] == pytest.approx([1, -2, 0, 0, 0.6, 0.8], abs=1e-15)
    disc = found.walls.parameter[(found.walls.kind == DISC)][0]
    assert disc[1] == pytest.approx(9.0)  # the closed end is the one along the axis
    assert found.motions == (
        PrescribedMotion((1, -2, 0)),
        PrescribedMotion((0, 0, 1)),
        PrescribedMotion(),
    )


def test_a_wall_turns_about_its_own_centre_unless_told_otherwise(make):
    motion = {"angular_velocity": [0, 0, 0.5]}
    own = {"velocity": [1, 2, 3], "centre": [9, 8, 7]}
    own["oscillation"] = {"amplitude": [0, 0, 0.01], "frequency": 10.0, "phase": 0.3}
    walls = [
        make.plane(point=[0, 0, 0.1], motion=motion),
        boxed("b", motion=motion),
        drum("c", centre=[0, 0, 3], motion=motion),
        boxed("d", motion=own),
    ]
    case = make.case(make.sphere(position=[0, 0, 1]), wall=walls, contact=make.hooke())
    motions = contact(case).motions
    assert [m.centre for m in motions] == [(0, 0, 0.1), (0, 0, 1), (0, 0, 3), (9, 8, 7)]
    assert motions[0].angular_velocity == (0, 0, 0.5)
    assert motions[0][3:] == PrescribedMotion()[3:]
    assert motions[3][1:6] == ((1, 2, 3), (0, 0, 0), (0, 0, 0.01), 10.0, 0.3)


def test_a_wall_has_the_code_of_its_material(make):
    materials = [material("steel"), material("glass")]
    walls = [make.plane(material="glass"), make.plane([1, 0, 0], "side", material="steel")]
    body = make.sphere(position=[1, 0, 1], material="steel")
    case = make.case(body, wall=walls, contact=make.hooke(), material=materials)
    assert contact(case).wall_material.tolist() == [1, 0]


def reading(monkeypatch, triangles):
    """A trimesh that reads these triangles."""
    corners = np.array(triangles, dtype=float).reshape(-1, 3)
    faces = np.arange(len(corners)).reshape(-1, 3)
    loaded = SimpleNamespace(vertices=corners, faces=faces)
    reader = SimpleNamespace(load_mesh=lambda content, **how: loaded)
    monkeypatch.setitem(sys.modules, "trimesh", reader)


@pytest.fixture
def mesh(tmp_path):
    """A wall of a file that is there."""
    (tmp_path / "a.stl").touch()
    return {"type": "mesh", "name": "m", "file": str(tmp_path / "a.stl")}


def test_a_mesh_is_read_scaled_turned_and_moved(make, mesh, monkeypatch):
    flat = [[0, 0, 0], [1, 1, 1], [2, 2, 2]]
    reading(monkeypatch, [[[0, 0, 0], [1, 0, 0], [0, 1, 0]], flat])
    mesh |= {"scale": 0.5, "position": [0, 0, 7], "orientation": {"euler_deg": [0, 0, 90]}}
    mesh |= {"motion": {"angular_velocity": [0, 0, 1]}}
    found = contact(make.case(make.sphere(), wall=[mesh], contact=make.hooke()))
    (face,) = found.walls.parameter[found.walls.kind == FACE]
    corners = {tuple(corner) for corner in np.round(face[:9].reshape(3, 3), 15).tolist()}
    assert corners == {(0, 0, 7), (0, 0.5, 7), (-0.5, 0, 7)}
    assert found.motions[0].centre == (0, 0, 7)


def test_a_body_that_overlaps_a_mesh_is_named(make, mesh, monkeypatch):
    reading(monkeypatch, [[[-9, -9, 0], [9, -9, 0], [0, 9, 0]]])
    for z, wrong in ((0.04, True), (-0.04, True), (0.11, False), (-0.11, False)):
        case = make.case(make.sphere(position=[0, 0, z]), wall=[mesh], contact=make.hooke())
        if wrong:
            assert only(case)[:2] == ("wall[0]", "overlaps bodies at t = 0: ball by 0.06 m")
        else:
            assert contact(case)


def test_a_mesh_that_cannot_be_read_is_an_error_at_its_file(make, mesh, monkeypatch):
    case = make.case(make.sphere(), wall=[mesh], contact=make.hooke())
    monkeypatch.setitem(sys.modules, "trimesh", None)  # as if it were not installed
    key, reason, hint = only(case)
    assert key == "wall[0].file"
    assert reason == 'reading it needs trimesh: pip install "particlerb[mesh]"'
    assert hint == "give an STL file"

    def broken(content, **how):
        raise RuntimeError("no such facet")

    monkeypatch.setitem(sys.modules, "trimesh", SimpleNamespace(load_mesh=broken))
    assert only(case)[1] == "trimesh cannot read it: no such facet"
    for triangles, reason in (
        (np.zeros((0, 3, 3)), "has no triangle: it is empty, cut off, or no STL file"),
        (np.ones((1, 3, 3)), "has no triangle with an area"),
        ([[[0, 0, 0], [1, 0, 0], [0, np.nan, 0]]], "has a corner that is not finite"),
        ([[[0, 0, 0], [1, 0, 0], [0, np.inf, 1]]], "has a corner that is not finite"),
    ):
        reading(monkeypatch, triangles)
        assert only(case)[1] == reason


# What starts wrong


def test_overlapping_bodies_are_named_with_their_depth(make):
    places = [[0, 0, 0], [0.15, 0, 0], [1, 0, 0], [1.19, 0, 0], [5, 5, 5]]
    case = make.case(balls(make, *places), contact=make.hooke())
    assert only(case) == (
        "body[0]",
        "bodies overlap at t = 0: ball[0] and ball[1] by 0.05 m, ball[2] and ball[3] by 0.01 m",
        "move them apart, say contact.relax = true, or allow it by contact.overlap",
    )


def test_few_of_many_overlaps_are_named_and_the_others_counted(make):
    places = np.outer(np.arange(30), [0.19, 0, 0])
    _, reason, _ = only(make.case(balls(make, *places), contact=make.hooke()))
    assert reason.count(" by 0.01 m") == 3
    assert reason.endswith(", and 26 more")


def test_the_deepest_place_of_two_bodies_counts_once(make):
    """Two dumbbells side by side: both pairs of balls overlap, and the message names one depth."""
    shape = {"type": "points", "position": [[0, 0, 0], [0, 0, 1]], "mass": 1, "radius": [0.1, 0.2]}
    bodies = [{"name": name, "shape": shape} for name in "ab"]
    bodies[1]["position"] = [0.15, 0, 0]
    reason = only(make.case(*bodies, contact=make.hooke()))[1]
    assert reason == "bodies overlap at t = 0: a and b by 0.25 m"


@pytest.mark.parametrize("distance", [0.2, 0.2 - 1e-12, 0.3])
def test_bodies_that_touch_do_not_overlap(make, distance):
    case = make.case(balls(make, [0, 0, 0], [distance, 0, 0]), contact=make.hooke())
    assert contact(case)


def test_overlap_that_is_allowed_relaxed_or_between_fixed_bodies_is_no_mistake(make):
    places = [[0, 0, 1], [0.15, 0, 1]]
    for keys in ({"overlap": 0.051}, {"relax": True}):
        assert contact(make.case(balls(make, *places), contact=make.hooke(**keys)))
    assert only(make.case(balls(make, *places), contact=make.hooke(overlap=0.049)))
    fixed = balls(make, *places, fixed=True)
    assert contact(make.case(make.sphere("a"), fixed, contact=make.hooke()))
    ghosts = balls(make, *places, contact=False)
    walls = [make.plane()]
    case = make.case(make.sphere("a", position=[0, 0, 1]), ghosts, contact=make.hooke(), wall=walls)
    assert contact(case)


def test_overlap_by_more_than_a_radius_is_a_mistake_whatever_is_allowed(make):
    """Springs would push out on the other side; where centres coincide, nowhere."""
    case = make.case(balls(make, [0, 0, 0], [0, 0, 0]), contact=make.hooke(overlap=0.5))
    told = "bodies overlap at t = 0: ball[0] and ball[1] by 0.2 m"
    assert only(case)[1:] == (told, "move them apart, or say contact.relax = true")
    case["contact"] = make.hooke(relax=True)
    com = remove_overlaps(to_system(case)).state.com
    assert np.ptp(com[0]) > 0.1999


def test_particles_of_one_body_may_overlap(make):
    shape = {"type": "points", "position": [[0, 0, 0], [0.1, 0, 0]], "mass": 1, "radius": 0.1}
    bodies = [{"name": "clump", "shape": shape}, make.sphere("b", position=[1, 0, 0])]
    assert contact(make.case(*bodies, contact=make.hooke()))


def test_overlaps_are_those_of_every_pair_at_once(make):
    """Random clumps against every pair of their particles, one by one."""
    rng = np.random.default_rng(3)
    shape = {"type": "points", "position": rng.standard_normal((5, 3)) * 0.2, "mass": 1.0}
    shape["radius"] = rng.uniform(0.02, 0.2, 5)
    n = 40
    body = {"name": "c", "shape": shape, "count": n, "orientation": "random"}
    body["place"] = {"type": "random", "lower": [0, 0, 0], "upper": [2, 2, 2]}
    system = to_system(make.case(body, contact=make.hooke()))
    local = system.particles.position
    q = make.rotation(orientations(system).T)
    points = [system.state.com[:, b] + q[b].apply(local) for b in range(n)]
    radius = system.particles.radius
    deep = {}
    for a, b in itertools.combinations(range(n), 2):
        gap = np.linalg.norm(points[a][:, None] - points[b][None], axis=2)
        depth = (radius[:, None] + radius[None] - gap).max()
        if depth > 0.0:
            deep[a, b] = depth
    with pytest.raises(CaseError) as caught:
        contact_of(system)
    worst = sorted(deep, key=lambda pair: -deep[pair])[:3]
    named = ", ".join(f"c[{a}] and c[{b}] by {deep[a, b]:.3g} m" for a, b in worst)
    reason = caught.value.problems[0].reason
    assert reason == f"bodies overlap at t = 0: {named}, and {len(deep) - 3} more"


def orientations(system):
    """Body to world quaternions (4, n)."""
    from particlerb.model.state import quaternion_product

    return quaternion_product(
        system.state.q, system.bodies.rotor_frame * np.array([[1.0], [-1], [-1], [-1]])
    )


BIN = {"type": "box", "name": "bin", "lower": [-1, -1, 0], "upper": [1, 1, 2]}
DRUM = {"type": "cylinder", "name": "drum", "radius": 1.0, "length": 2.0}
FLOOR = {"type": "plane", "name": "p", "normal": [0, 0, 2]}
RAISED = {"oscillation": {"amplitude": [0, 0, 0.5], "frequency": 1.0, "phase": math.pi / 2}}
AT_WALLS = [
    # wall, place of a ball of radius 0.1, what is wrong
    (FLOOR, [0, 0, 0.1], ""),
    (FLOOR, [0, 0, 0.04], "by 0.06 m"),
    (FLOOR, [0, 0, -0.5], "is behind the plane"),
    (FLOOR | {"motion": RAISED}, [0, 0, 0.6], ""),
    (FLOOR | {"motion": RAISED}, [0, 0, 0.54], "by 0.06 m"),
    (FLOOR | {"motion": RAISED}, [0, 0, 0.4], "is behind the plane"),
    (BIN, [0.9, -0.9, 0.1], ""),
    (BIN, [0.95, 0, 1], "by 0.05 m"),
    (BIN, [0, 0, 2.5], "is outside the box"),
    (BIN, [0, 1.05, 1], "is outside the box"),
    (BIN | {"motion": RAISED}, [0, 0, 2.2], ""),
    (BIN | {"motion": RAISED}, [0, 0, 0.2], "is outside the box"),
    (BIN | {"open": ["+z"]}, [0, 0, 2.5], ""),
    (BIN | {"open": ["+z"]}, [0.95, 0, 2.5], ""),  # above the edge
    (BIN | {"open": ["+z"]}, [0.95, 0, 2.04], "by 0.036 m"),  # 0.1 - √(0.05² + 0.04²)
    (BIN | {"open": ["+z"]}, [1.5, 0, 2.5], "is outside the box"),
    (BIN | {"open": ["-x"]}, [-3, 0, 1], ""),
    (BIN | {"inside": False}, [0, 0, 2.5], ""),
    (BIN | {"inside": False}, [0, 1.05, 1], "by 0.05 m"),
    (DRUM, [0, 0.9, 0.9], ""),
    (DRUM, [0.57, 0.76, 0], "by 0.05 m"),
    (DRUM, [0, 0, -0.92], "by 0.02 m"),
    (DRUM, [0, 0, 1.2], "is outside the cylinder"),
    (DRUM, [0, 1.2, 0], "is outside the cylinder"),
    (DRUM | {"open": ["+"]}, [0, 0, 1.2], ""),
    (DRUM | {"open": ["+"]}, [0, 0, -1.2], "is outside the cylinder"),
    (DRUM | {"inside": False}, [0, 1.2, 0], ""),
    (DRUM | {"inside": False, "axis": [0, 0.6, 0.8]}, [0, 0.63, 0.84], "by 0.05 m"),
    (DRUM | {"axis": [0, 6, 8]}, [0, 0.6, 0.8], "is outside the cylinder"),
    (DRUM | {"axis": [0, 6, 8]}, [0.5, 0.48, 0.64], ""),
]


@pytest.mark.parametrize(("wall", "place", "wrong"), AT_WALLS)
def test_a_body_beyond_a_wall_is_named(make, wall, place, wrong):
    case = make.case(make.sphere(position=place), wall=[wall], contact=make.hooke())
    relaxed = make.case(make.sphere(position=place), wall=[wall], contact=make.hooke(relax=True))
    if not wrong:
        assert contact(case)
        assert contact(relaxed)
        return
    key, reason, _ = only(case)
    assert key == "wall[0]"
    if wrong.startswith("is"):
        assert reason == f"ball {wrong} at t = 0"
        assert only(relaxed)[1] == reason
    else:
        assert reason == f"overlaps bodies at t = 0: ball {wrong}"
        assert contact(relaxed)


@pytest.mark.parametrize("wall", [BIN, DRUM | {"centre": [0, 0, 1]}, FLOOR])
def test_a_body_that_sticks_out_of_a_wall_is_named_with_its_depth(make, wall):
    """The upper ball is inside, and so is the centre of mass; the lower one is wholly outside."""
    shape = {"type": "points", "position": [[0, 0, 0], [0, 0, 1.5]], "mass": [1, 9], "radius": 0.1}
    body = {"name": "dumbbell", "shape": shape, "position": [0, 0, 1.0]}
    reason = only(make.case(body, wall=[wall], contact=make.hooke()))[1]
    assert reason == "overlaps bodies at t = 0: dumbbell by 0.45 m"  # 1.5 · 0.9 - 1 + 0.1
    for keys in ({"overlap": 0.5}, {"relax": True}):
        assert contact(make.case(body, wall=[wall], contact=make.hooke(**keys)))


def test_few_of_many_bodies_beyond_a_wall_are_named(make):
    places = [[x, 0, -1] for x in range(5)] + [[x, 0, 0.05] for x in range(5)]
    case = make.case(
        make.sphere("a", position=[0, 5, 1]),
        balls(make, *places),
        wall=[make.plane(), make.plane([0, 0, 1], "low", point=[0, 0, -1.05])],
        contact=make.hooke(),
    )
    found = problems(case)
    assert found[0][1] == "ball[0], ball[1], ball[2], and 2 more are behind the plane at t = 0"
    named = [", ".join(f"ball[{k + i}] by 0.05 m" for i in range(3)) for k in (5, 0)]
    assert [p[:2] for p in found[1:]] == [
        ("wall[0]", f"overlaps bodies at t = 0: {named[0]}, and 2 more"),
        ("wall[1]", f"overlaps bodies at t = 0: {named[1]}, and 2 more"),
    ]


def test_fixed_bodies_may_lie_in_walls(make):
    bodies = [make.sphere("post", fixed=True), make.sphere("a", position=[0, 0, 1])]
    assert contact(make.case(*bodies, wall=[make.plane()], contact=make.hooke()))


def test_problems_of_a_file_are_shown_in_it(tmp_path):
    text = """\
[run]
t_end = 1
every = 1
[contact]
stiffness = 1
friction = 0
restitution = 1
[[body]]
name = "a"
shape = { type = "sphere", radius = 0.1 }
mass = 1
[[body]]
name = "b"
shape = { type = "sphere", radius = 0.1 }
mass = 1
"""
    system = to_system(parse(text, tmp_path / "a.toml"))
    with pytest.raises(CaseError) as caught:
        contact_of(system)
    (problem,) = caught.value.problems
    assert (problem.line, problem.source) == (12, "[[body]]")
    assert problem.reason == "bodies overlap at t = 0: a and b by 0.2 m"


def test_a_ball_and_a_sphere_are_one_shape_that_touches(make):
    ball, sphere = ({"type": word, "radius": 0.5} for word in ("ball", "sphere"))
    places = [[0, 0, 0.5], [0, 0, 1.5]]
    bodies = [
        {"name": shape["type"], "shape": shape, "density": 3.0, "position": place}
        for shape, place in zip((ball, sphere), places, strict=True)
    ]
    system = to_system(make.case(*bodies, contact=make.hooke(), wall=[make.plane()]))
    assert system.body[0].shape == system.body[1].shape
    assert system.kind.tolist() == [0, 0]
    assert contact_of(system).body.tolist() == [0, 1]
    assert system.particles.radius.tolist() == [0.5]


@pytest.mark.parametrize("filled", [{"n": 4}, {"inertia_error": 0.1}, {"arrangement": "cells"}])
def test_a_ball_that_is_filled_has_particles_without_radius(make, filled):
    body = {"name": "b", "shape": {"type": "ball", "radius": 0.5} | filled, "mass": 1.0}
    system = to_system(make.case(body))
    assert len(system.particles.radius) > 1
    assert not system.particles.radius.any()
    again = load(to_case(system).model_dump(mode="json"))
    assert again.body == system.body
    assert "nothing can touch this body" in only(make.case(body, contact=make.hooke()))[1]


@pytest.mark.parametrize("law", ["hertz", "impulse"])
def test_who_touches_nothing_changes_no_step_of_those_that_touch(make, law):
    """However high above them it is."""
    balls = [make.sphere(name, position=[k, 0, 0.3]) for k, name in enumerate(("a", "b"))]
    high = make.body("high", position=[0, 0, 1e4], contact=False)
    tables = {
        "contact": {"law": law, "restitution": 0.9, "friction": 0.3},
        "material": [{"name": "glass", "young": 1e7, "poisson": 0.25}],
        "gravity": {"acceleration": [0.0, 0.0, -9.81]},
        "wall": [make.plane()],
    }
    alone, beside = (
        make_plan(to_system(make.case(*bodies, **tables))).groups[0].segments[0].dt
        for bodies in (balls, [*balls, high])
    )
    assert alone == beside > 0.0
