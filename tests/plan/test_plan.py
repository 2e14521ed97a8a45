"""The plan: levels, methods, steps, and the reasons that it gives in words."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import particlerb
from particlerb.case.problems import CaseError, Source
from particlerb.case.reader import load
from particlerb.case.side_by_side import side_by_side
from particlerb.case.to_system import to_system
from particlerb.integrators import METHODS
from particlerb.model.bodies import made_of, taken
from particlerb.model.state import State, rotate
from particlerb.plan import known_courses, rates
from particlerb.plan.describe import describe
from particlerb.plan.make_plan import make_plan
from particlerb.plan.time_step import RADIANS_PER_STEP
from particlerb.rotors.rotor_class import ASYMMETRIC, POINT, ROD, SPHERE, SYMMETRIC
from particlerb.simulation.accuracy import prepare_accurately
from particlerb.simulation.run import prepare

SPIN = {"angular_velocity": [1.0, 0.4, -0.7]}
AT, FORCE = [0.4, -0.3, 0.2], [1.0, 2.0, -1.5]


def plan_of(case):
    return prepare(to_system(case)).plan


def levels(case):
    """(start, stop, method) of the segments of every group."""
    return [[(s.start, s.stop, s.method) for s in g.segments] for g in plan_of(case).groups]


inf = float("inf")


def test_the_plan_says_from_where_points_of_forces_count(make):
    """A cube with a weight at a corner, whose centre of mass is not the middle of the cube."""
    cube = {"shape": {"type": "box", "size": [2, 2, 2], "arrangement": "exact"}, "mass": 8.0}
    weight = {"shape": {"type": "points", "position": [[0, 0, 0]], "mass": 1.0},
              "mass": 1.0, "position": [1, 1, 1]}  # fmt: skip
    body = {"name": "cube", "part": [cube, weight]}
    push = {"type": "push", "body": "cube", "force": [0, 0, 1.0]}
    words = "`at` counts from the centre of mass, which of cube is at (0.111111111, 0.111111111, "

    def said(part, **keys):
        return words in prepare(to_system(make.case(body | part, force=[push | keys]))).text

    assert said({}, at=[1, 1, 1])
    assert not said({})
    assert not said({"part": [cube]}, at=[1, 1, 1])


def test_time_is_cut_where_a_force_starts_or_stops(make):
    forces = [
        make.push(FORCE, AT, during=[0.2, 0.5]),
        make.torque([1, 0, 0], during=[0.4, 0.7]),
        make.impulse([1, 0, 0], time=0.9),
    ]
    assert levels(make.case(make.body(), make.body("free"), force=forces)) == [
        [
            (0.0, 0.2, "exact"),
            (0.2, 0.4, "strang"),
            (0.4, 0.5, "strang"),
            (0.5, 0.7, "strang"),
            (0.7, 0.9, "exact"),
            (0.9, inf, "exact"),
        ],
        [(0.0, inf, "exact")],
    ]


def test_a_named_method_steps_all_that_rotates(make):
    bodies = [make.body("a"), make.body("point", [0, 0, 0]), make.body("pushed")]
    force = [make.push(FORCE, AT, "pushed", during=[0.2, 0.5]), make.push(FORCE, body="point")]
    case = make.case(*bodies, force=force, method="strang", dt=0.01)
    assert levels(case) == [
        [(0.0, inf, "strang")],
        [(0.0, inf, "exact")],
        [(0.0, 0.2, "strang"), (0.2, 0.5, "strang"), (0.5, inf, "strang")],
    ]
    assert "driven by nothing, but the case names the method" in prepare(to_system(case)).text


@pytest.mark.parametrize("frame", ["world", "body"])
def test_exact_refuses_a_driving_force(make, frame):
    force = [make.push(FORCE, AT, frame=frame)]
    with pytest.raises(CaseError, match=r"run\.method") as caught:
        particlerb.run(make.case(make.body(), force=force, method="exact"))
    assert "methods that do: strang" in str(caught.value)
    free = make.case(make.body(), force=[make.push(FORCE)], method="exact")
    assert levels(free) == [[(0.0, inf, "exact")]]


def test_bodies_with_the_same_forces_form_a_group(make):
    block = make.body("clump", count=6, place={"type": "grid", "spacing": 1.0})
    force = [make.push(FORCE, AT, ["clump[4]", "clump[1]"]), make.torque([1, 0, 0], "clump[4]")]
    groups = plan_of(make.case(block, force=force)).groups
    assert [g.members.tolist() for g in groups] == [[0, 2, 3, 5], [1], [4]]


# The step


@given(w=st.floats(0.01, 1e3), every=st.floats(1e-3, 0.5))
def test_default_step_of_a_spinning_body(make, w, every):
    body = make.body(angular_velocity=[0, 0, w])
    plan = plan_of(make.case(body, every=every, method="strang"))
    expected = min(every, RADIANS_PER_STEP / w)
    assert plan.groups[0].segments[0].dt == pytest.approx(expected, rel=1e-12)
    chosen = "run.every" if expected == every else "0.05 / ("
    assert f"= {chosen}" in plan.step


def test_default_step_of_a_body_at_rest_knows_the_force(make):
    """√(torque / smallest moment), with |r| |F| for the torque of a push; |r| J / I of a hit."""
    hard = 1e4 * np.array(FORCE)
    for force, rate in (
        (make.push(hard, AT), np.sqrt(np.linalg.norm(AT) * np.linalg.norm(hard) / 1.0)),
        (make.torque([0, 3e4, 4e4]), np.sqrt(5e4)),
        (make.push([0, 0, 1e4], [3, 4, 0], frame="body"), np.sqrt(5e4)),
        (make.impulse([0, 0, 300.0], [3, 4, 0]), 1500.0),
    ):
        segment = plan_of(make.case(make.body(), force=[force], method="strang")).groups[0]
        assert segment.segments[0].dt == pytest.approx(RADIANS_PER_STEP / rate, rel=1e-12)


def test_default_step_knows_how_far_a_torque_that_ends_spins_a_body_up(make):
    """|τ| Δt / I_min = 10 · 20 / 1 rad/s, whatever t_end is."""
    for t_end in (1.0, 30.0):
        load = make.torque([0, 0, 10.0], during=[0.0, 20.0])
        plan = plan_of(make.case(make.body(), force=[load], t_end=t_end, method="strang"))
        assert plan.groups[0].segments[0].dt == pytest.approx(RADIANS_PER_STEP / 200.0, rel=1e-9)
        assert plan.warnings == ()


def test_a_torque_without_end_warns_and_leaves_the_step_to_what_it_was(make):
    """√(τ / I) sets the step; after t_end the spin τ t / I would turn 1.6 rad in one step."""

    def case(t_end):
        force = [make.torque([0, 0, 10.0])]
        return make.case(make.body(), force=force, t_end=t_end, method="strang")

    short, long = plan_of(case(0.1)), plan_of(case(10.0))
    assert short.warnings == ()
    (warning,) = long.warnings
    assert "turns bodies like body by up to 1.58 rad" in warning
    assert short.groups[0].segments[0].dt == long.groups[0].segments[0].dt


@given(dt=st.floats(1e-4, 1.0), length=st.floats(1e-3, 1.0))
def test_steps_divide_a_segment_evenly_and_are_not_longer(make, dt, length):
    force = [make.push(FORCE, AT, during=[0.0, length])]
    segment = plan_of(make.case(make.body(), force=force, dt=dt, t_end=2.0)).groups[0].segments[0]
    steps = length / segment.dt
    assert steps == pytest.approx(round(steps), rel=1e-12)
    assert segment.dt <= dt * (1 + 1e-11)
    assert segment.dt > dt / 2 or round(steps) == 1


def test_a_step_that_is_too_long_warns(make):
    body = make.body(angular_velocity=[0, 0, 10.0])
    case = make.case(body, method="strang", dt=0.0501)
    (warning,) = plan_of(case).warnings
    assert ": warning: " in warning
    assert "the step of 0.0501 s turns bodies like body by up to 0.501 rad" in warning
    assert "advised: dt = 0.005 s or less" in warning
    limit = make.case(body, method="strang", dt=METHODS["strang"].max_turn / 10.0)
    assert plan_of(limit).warnings == ()
    assert plan_of(make.case(body, dt=1.0)).warnings == ()  # free: nothing is stepped


def test_no_warning_about_steps_that_are_cut_or_were_tried(make):
    """A step ends where its segment does, and `accuracy` takes steps whose error it has seen."""
    body, turn = make.body(angular_velocity=[0, 0, 10.0]), METHODS["strang"].max_turn
    short = make.case(body, method="strang", dt=5.0, t_end=0.09 * turn, every=0.01 * turn)
    assert plan_of(short).warnings == ()
    (warning,) = plan_of(short | {"run": short["run"] | {"t_end": 0.2 * turn}}).warnings
    assert f"the step of {0.2 * turn:.6g} s turns" in warning
    load = make.push(FORCE, AT, frame="body", during=[0.55, 7.0])
    force_free = make.body(angular_velocity=[1.0, 0.4, -0.7])
    tried = prepare_accurately(to_system(make.case(force_free, force=[load], accuracy=1e-8)))
    assert tried.plan.warnings == ()


# The words


def lines(case):
    """Lines of the plan by their name; several under one name joined."""
    found = {}
    for line in prepare(to_system(case)).text.splitlines():
        name, text = re.fullmatch(r"  (\S.*?)\s{2,}(\S.*)", line).groups()
        found[name] = found.get(name, "") + text + "\n"
    return found


def test_plan_gives_a_reason_for_what_is_left_out(make):
    text = lines(make.case(make.body()))
    assert text["bodies"] == "1 asymmetric top\n"
    left_out = "gravity, attraction, joints, forces, contact (no particle has a radius)\n"
    assert text["left out"] == left_out
    assert not {"gravity", "attraction", "joints", "contact", "push"} & text.keys()
    assert text["step"] == "none: every motion has a closed form\n"
    unused = lines(make.case(make.body(), dt=0.01))["step"]
    assert unused == "none: every motion has a closed form, and run.dt is not used\n"
    assert text["energy balance"].strip().endswith("every force has a potential")
    assert text["body"] == "from 0 s: free, closed form, no step (nothing acts)\n"
    zero = lines(make.case(make.body(), gravity={"acceleration": [0, 0, 0]}))
    assert zero["left out"].startswith("gravity, ")


def test_the_whole_plan_leaves_nothing_out(make):
    """Thirty groups, one of forty segments: nothing is cut, and what is absent has a line."""
    bodies = [make.body(f"b{k}") for k in range(30)]
    pushes = [make.push(FORCE, AT, f"b{k}", during=[0.01 * k, 0.9]) for k in range(30)]
    pushes += [make.push(FORCE, AT, "b0", during=[0.01 * k, 0.02 + 0.01 * k]) for k in range(40)]
    prepared = prepare(to_system(make.case(*bodies, force=pushes, dt=0.01)))
    short = describe(*prepared[:2])
    for words in ("more groups of bodies", "more segments", "left out"):
        assert words in short
    whole = describe(*prepared[:2], is_whole=True)
    assert not re.search(r" more |left out", whole)
    assert re.search(r"^  gravity +off: no \[gravity\]$", whole, re.MULTILINE)
    still = prepare(to_system(make.case(make.body(), gravity={"acceleration": [0, 0, 0]})))
    assert "off: its acceleration is 0\n" in describe(*still[:2], is_whole=True)
    assert re.search(r"^  attraction +off: no \[attraction\]$", whole, re.MULTILINE)
    assert re.search(r"^  contact +off: no particle has a radius$", whole, re.MULTILINE)
    named = set(re.findall(r"^  (b\d+) ", whole, re.MULTILINE))
    assert named == {f"b{k}" for k in range(30)}


def test_plan_gives_a_reason_for_what_is_done(make):
    ball = {"type": "points", "position": [[0, 0, 0], [1, 0, 0]], "mass": [1, 2], "radius": [1, 1]}
    forces = [
        make.push(FORCE, AT, during=[0.2, 0.5]),
        make.push(FORCE, AT, "other", frame="body"),
        make.impulse([1, 0, 0], time=0.9),
        make.push(FORCE, body="third"),
    ]
    bodies = [make.body(), make.body("other"), make.body("third", shape=ball, mass=3.0)]
    gravity = {"acceleration": [0, 0, -9.8]}
    text = lines(make.case(*bodies, force=forces, dt=0.1, gravity=gravity))
    assert text["gravity"] == "(0, 0, -9.8) m/s²\n"
    assert text["push"] == "3 in the case\n"
    assert text["left out"] == "attraction, joints, contact (no [contact])\n"
    assert text["step"] == "0.1 s, as the case says\n"
    assert "step by step: a force without potential acts" in text["energy balance"]
    assert text["body"].splitlines() == [
        "0 s to 0.2 s: free, closed form, no step (gravity through the centre of mass: a parabola)",
        "0.2 s to 0.5 s: driven by gravity and push, strang, 3 steps of 0.1 s",
        "0.5 s to 0.9 s: free, closed form, no step (gravity through the centre of mass:"
        " a parabola)",
        "from 0.9 s: after 1 impulse, free, closed form, no step (gravity through the centre of"
        " mass: a parabola)",
    ]
    driven = "driven by gravity and load fixed in the body, strang, steps of 0.1 s"
    assert text["other"] == f"from 0 s: {driven}\n"
    assert "(gravity and push through the centre of mass: a parabola)" in text["third"]


def test_a_step_of_the_case_is_told_with_nine_digits(make):
    pushed = make.case(make.body(), force=[make.push(FORCE, AT)], dt=0.3 / 7.0)
    assert lines(pushed)["step"] == "about 0.0428571429 s, as the case says\n"


def test_forces_of_one_form_share_a_group_and_keep_their_own_size(make):
    """One group for many bodies with a push each; a push at the com is of another form."""
    block = make.body("c", count=40, place={"type": "grid", "spacing": 1.0})
    force = [make.push([0, 0, 1.0 + k], AT, f"c[{k}]") for k in range(30)]
    force.append(make.push([0, 0, 7.0], [0, 0, 0], "c[30]"))
    groups = plan_of(make.case(block, force=force, dt=0.1)).groups
    assert [group.members.size for group in groups] == [30, 1, 9]
    (push,) = groups[0].segments[0].terms.loads
    np.testing.assert_array_equal(push.force[2], 1.0 + np.arange(30))
    assert [group.segments[0].method for group in groups] == ["strang", "exact", "exact"]


def test_groups_have_a_step_of_their_own(make):
    """A fast body does not shorten the step of a slow one."""
    bodies = [make.body("fast", angular_velocity=[0, 0, 50.0]), make.body("slow")]
    plan = plan_of(make.case(*bodies, force=[make.push(FORCE, AT, ["fast", "slow"])]))
    assert len(plan.groups) == 1
    force = [make.push(FORCE, AT, "fast", during=[0.0, 1e-3]), make.push(FORCE, AT, "slow")]
    fast, slow = (group.segments[0].dt for group in plan_of(make.case(*bodies, force=force)).groups)
    assert fast <= 1e-3 < slow


@pytest.mark.parametrize(("keys", "key"), [({"dt": 1e-25}, "run.dt"), ({}, "run")])
def test_a_step_that_never_gets_there_is_refused(make, keys, key):
    force = [make.push(FORCE if keys else [1e60, 2e60, -1e60], AT)]
    with pytest.raises(CaseError, match=rf"{key}: the step of .* times until t_end"):
        plan_of(make.case(make.body(), force=force, **keys))


def test_plan_of_many_groups_is_cut_short(make):
    block = make.body("c", count=60, place={"type": "grid", "spacing": 1.0})
    force = [
        make.push([0, 0, 1.0], AT, f"c[{2 * k}]", during=[0.0, 0.01 * (k + 1)]) for k in range(25)
    ]
    text = lines(make.case(block, force=force, dt=0.1))
    assert text["..."] == "and 6 more groups of bodies\n"
    assert any(name.startswith("bodies 1, 3, 5, 7, ... (35)") for name in text)


# Closed forms under force


def test_only_bodies_with_an_axis_where_the_force_acts_have_a_closed_form(make):
    """By class and lever alone; those of a group that have none are stepped apart."""
    shapes = {
        "top": ([1, 1, 0.6], "exact"), "across": ([0.6, 1, 1], "strang"),
        "sphere": ([2, 2, 2], "exact"), "brick": ([1, 1.2, 0.6], "strang"),
        "rod": ([1, 1, 0], "exact"),
    }  # fmt: skip
    bodies = [make.body(name, inertia) for name, (inertia, _) in shapes.items()]
    force = make.push([1, 2, 3], [0, 0, 0.4], list(shapes))
    plan = plan_of(make.case(*bodies, force=[force]))
    assert [g.members.tolist() for g in plan.groups] == [[0, 2, 4], [1, 3]]
    assert [g.segments[0].method for g in plan.groups] == ["exact", "strang"]
    second = make.push([0, 1, 0], [0.1, 0, 0], list(shapes)[:-1])  # another axis: no rank 1
    plan = plan_of(make.case(*bodies, force=[force, second]))
    methods = {g.members[0]: g.segments[0].method for g in plan.groups}
    assert methods == {0: "strang", 4: "exact"}
    text = prepare(to_system(make.case(bodies[0], force=[make.push([1, 2, 3], [0, 0, 1], "top")])))
    assert "closed form, no step (one force on the axis: Lagrange's top)" in text.text


def test_a_named_method_steps_a_top_and_exact_takes_it(make):
    body, force = make.body(inertia=[1, 1, 0.6]), [make.push([1, 2, 3], [0, 0, 0.4])]
    assert levels(make.case(body, force=force, method="rkn6")) == [[(0.0, inf, "rkn6")]]
    assert levels(make.case(body, force=force, method="exact")) == [[(0.0, inf, "exact")]]
    both = make.case(body, make.body("brick"), force=[*force, make.push(FORCE, AT, "brick")])
    with pytest.raises(CaseError, match="exact does not accept what acts here: push"):
        plan_of(both | {"run": both["run"] | {"method": "exact"}})


@pytest.mark.plain
def test_bodies_that_a_spring_has_tied_stay_together(make):
    """Once it has ended only one of them has a closed form: the spring still knows both."""
    bodies = make.body("a", (1.0, 1.0, 1.0)), make.body("b", position=[1, 0, 0])
    spring = make.tie("b", 10.0, "a", rest_length=0.5, during=[0, 0.1])
    force = [spring, make.push([0.1, 0.2, 0.3], [0.1, 0.05, 0], ["a", "b"])]
    scene = make.case(*bodies, force=force, t_end=0.3, dt=0.01)
    (group,) = prepare(to_system(scene)).plan.groups
    assert sorted(group.members.tolist()) == [0, 1]
    with particlerb.run(scene) as t:
        x, p = np.array(t.position), np.array(t.linear_momentum)
        assert np.abs(t.ledger.linear_momentum_error).max() < 1e-14
    assert p[-1] - p[1] == pytest.approx(np.tile([0.02, 0.04, 0.06], (2, 1)), abs=1e-13)
    assert x[1, 0, 0] > x[0, 0, 0] + 0.01


@pytest.mark.plain
@pytest.mark.parametrize("law", ["hertz", "impulse"])
def test_the_step_of_a_scene_does_not_depend_on_where_it_stands(make, law):
    """Its bodies fall as far."""
    steps = []
    for z in (0.0, 3e5):
        case = make.case(
            make.sphere(position=[0, 0, z + 0.5]),
            wall=[make.plane(point=[z, 0, z])],
            gravity={"acceleration": [0, 0, -9.81]},
            material=[{"name": "steel", "young": 1e7, "poisson": 0.3}],
            contact={"law": law, "restitution": 0.5, "friction": 0.3},
        )
        ((segment,),) = (group.segments for group in plan_of(case).groups)
        steps.append(segment.dt)
    assert steps[1] == pytest.approx(steps[0], rel=1e-9)


def test_bodies_far_from_turning_about_an_axis_are_told_by_rounded_numbers(monkeypatch):
    """One at rest, exactly about an axis, nearly so by a little, and anyhow; of each kind."""
    random = np.random.default_rng(5)
    code = np.repeat([POINT, ROD, SPHERE, SYMMETRIC, ASYMMETRIC], 40)
    q = random.normal(size=(4, code.size))
    q[:, ::2] = np.round(3.0 * q[:, ::2])  # of which the matrices are integers
    q[0] += ~q.any(axis=0)
    axis = np.eye(3)[:, random.integers(0, 3, code.size)]
    L = rotate(q, axis) * 10.0 ** random.integers(-300, 100, code.size)
    L += (
        np.abs(L).max(axis=0) * random.choice([0.0, 1e-17, 1e-13, 0.1], code.size) * axis[[1, 2, 0]]
    )
    L[:, ::7] = 0.0
    nothing = np.zeros((3, code.size))
    bodies, state = made_of(1.0 + 0.0 * q[0], 1.0 + nothing, q, code), State(nothing, q, nothing, L)
    each = [(taken(bodies, b), taken(state, b)) for b in np.arange(code.size)[:, None]]

    def axes():
        return [known_courses.Courses(*one).turning.axis[0] for one in each]

    with monkeypatch.context() as plain:
        plain.setattr(known_courses._Turning, "is_astray", lambda turning, v: False)
        expected = axes()
    looked_at = []
    exact = known_courses.exact_matrix
    monkeypatch.setattr(known_courses, "exact_matrix", lambda q: looked_at.append(1) or exact(q))
    assert axes() == expected
    assert len(set(expected)) > 3
    assert len(looked_at) < 0.7 * code.size


@pytest.mark.parametrize("run", [{}, {"accuracy": 1e-3}])
def test_rates_are_looked_for_once_in_a_plan(make, monkeypatch, run):
    looked, found = [], rates.omega_world
    monkeypatch.setattr(rates, "omega_world", lambda *at: looked.append(1) or found(*at))
    prepare_accurately(to_system(make.case(make.body(**SPIN), force=[make.push(FORCE, AT)], **run)))
    assert len(looked) == 1


@pytest.mark.parametrize(("run", "n"), [({}, 1), ({"dt": 0.1}, 0)])
def test_rates_of_worlds_are_looked_for_where_a_step_is_chosen(make, monkeypatch, run, n):
    looked, found = [], rates.omega_world
    monkeypatch.setattr(rates, "omega_world", lambda *at: looked.append(1) or found(*at))
    case = make.case(make.body(**SPIN), force=[make.push(FORCE, AT)], method="strang", **run)
    paths = [("body", 0, "angular_velocity", 0)]
    make_plan(side_by_side(Source(raw=case), paths, [[0.1], [0.2]]))
    assert len(looked) == n


def test_a_torque_without_end_spins_up_until_the_time_that_is_asked_for(make):
    """|ω| + Σ |τ| Δt / I: 2 rad/s, 5 N m for 4 s, and 3 N m from then on."""
    cube = {"type": "moments", "inertia": [2.0, 2.0, 2.0]}
    body = make.body(shape=cube, angular_velocity=[0, 0, 2.0])
    torques = [make.torque([3.0, 0, 0]), make.torque([0, 4.0, 0], during=[0.0, 4.0])]
    system = to_system(make.case(body, method="strang", force=torques))
    (group,) = prepare(system).plan.groups
    at = [rates.rates(system, group, t_end) for t_end in (0.0, 4.0, 10.0)]
    np.testing.assert_allclose(np.ravel(at), [12.0, 12.0, 21.0], rtol=1e-15)


@pytest.mark.parametrize(("t_end", "is_told"), [(8e13, False), (1e14, True), (1e300, True)])
def test_an_angle_that_is_lost_in_the_rounding_of_the_time_is_told(make, t_end, is_told):
    """1 rad/s times 2^-53 t_end is 0.01 rad at 9e13 s; closed forms have no step to warn of."""
    body = make.body("top", angular_velocity=[0.0, 0.0, 1.0])
    told = prepare(to_system(make.case(body, t_end=t_end, every=t_end))).plan.warnings
    assert len(told) == is_told
    assert all("its angle at t_end is not known" in text for text in told)
    assert all("until 9e+13 s it is known to 0.01 rad" in text for text in told)


@pytest.mark.plain
def test_balls_without_walls_are_told_without_walls():
    """It said «5 spheres and 0 walls»."""
    assert "contact         5 spheres, hooke" in prepare(to_system(load("newtons_cradle"))).text
