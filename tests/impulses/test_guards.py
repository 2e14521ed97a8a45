"""What contact by impulses does not do yet, and keys of the other laws, are refused in words."""

from pathlib import Path

import numpy as np
import pytest
from impulse_scenes import DOWN, R, case, go, impulse, plane, sphere

import particlerb
from particlerb.case.problems import CaseError

BALL = sphere(position=[0, 0, R])
HOOKE = {"stiffness": 1e5, "restitution": 0.5, "friction": 0.5}
PISTON = plane(piston={"mass": 1.0, "axis": [0, 0, 1], "limits": [-1, 1]})
SPRING = {"type": "spring", "body": "ball", "stiffness": 10.0, "at": [0, 0, 0],
          "anchor": [0, 0, 1]}  # fmt: skip
REFUSED = [
    ({"contact": impulse(stiffness=1e5)}, "contact.stiffness: impulses have no stiffness"),
    ({"contact": impulse(attract=True)}, "contact.attract: impulses have neither"),
    ({"contact": HOOKE | {"slop": 0.1}}, 'contact.slop: is for impulses'),
    ({"contact": HOOKE | {"solver": "newton"}}, 'contact.solver: is for impulses'),
    ({"contact": impulse(), "wall": [PISTON]}, "piston.limits: impulses do not stop pistons yet"),
    ({"contact": impulse(), "wall": [PISTON | {"motion": {"velocity": [1, 0, 0]}}]},
     "wall[0].motion: impulses do not move a piston with a motion on top yet"),
    ({"contact": HOOKE | {"torsional_friction": 0.1}},
     "contact.torsional_friction: impulses alone resist spinning"),
    ({"contact": impulse(), "method": "strang"}, "strang does not accept what acts here: contact"),
    ({"contact": HOOKE, "method": "moreau"}, "moreau is for contact by impulses"),
    ({"contact": impulse(iterations=0)}, "contact.iterations"),
]  # fmt: skip


@pytest.mark.parametrize(("keys", "words"), REFUSED, ids=[words for _, words in REFUSED])
def test_what_impulses_do_not_know_is_refused(keys, words):
    with pytest.raises(CaseError) as error:
        go(BALL, **({"wall": [plane()], "gravity": DOWN, "dt": 1e-3} | keys))
    assert words in str(error.value)
    assert "methods that do: moreau" in str(error.value) or "strang does" not in words


@pytest.mark.parametrize("contact", [impulse(), HOOKE], ids=["impulse", "springs"])
def test_what_no_method_takes_is_refused_with_what_to_leave_out(contact):
    hinge = {"type": "hinge", "body": "ball", "axis": [0, 1, 0], "at": [1, 0, R]}
    lift = {"type": "magnus", "body": "ball", "coefficient": 0.1}
    with pytest.raises(CaseError, match="methods that do: none; without contact: dop853"):
        go(BALL, contact=contact, joint=[hinge], force=[lift], wall=[plane()], dt=1e-3)


def test_an_accuracy_is_refused_whatever_the_materials():
    """One ball alone has its material, so it has no partner of it; and impulses no stiffness."""
    slope = Path(__file__).parents[2] / "cases" / "impulse_slope.toml"
    with pytest.raises(CaseError, match=r"run\.accuracy: is for contacts with a stiffness"):
        particlerb.run(slope, overrides=["run.accuracy=1e-3"])


def test_a_step_is_chosen_by_size_and_speed_and_said_with_what_overlap_to_expect():
    from particlerb.case.reader import load
    from particlerb.case.to_system import to_system
    from particlerb.simulation.run import prepare

    fall = sphere(position=[0, 0, 1.0])
    text = prepare(
        to_system(load(case(fall, contact=impulse(0.3), wall=[plane()], gravity=DOWN)))
    ).text
    speed = (2 * 9.81 * 1.0) ** 0.5
    assert f"{0.1 * R / speed:.6g} s = the rule of impulses" in text
    (overlap,) = [line for line in text.split("\n") if line.startswith("  overlap ")]
    assert f"about {0.05 * R:.3g} m in the fastest impact" in overlap
    assert "for which springs and impulses cost about the same" in overlap
    assert "coupled by contact, driven by gravity, moreau" in text


@pytest.mark.parametrize(
    ("moving", "speed"),
    [
        ({"velocity": [2.0, 0, 0]}, 2.0),
        ({"angular_velocity": [0, 0, 4.0], "centre": [-1.0, 0, R]}, 4.0 * (1.0 + R)),
        ({"oscillation": {"amplitude": [0, 0.1, 0], "frequency": 5.0}}, np.pi),
    ],
)
@pytest.mark.parametrize("is_wall", [False, True])
def test_a_step_is_chosen_by_what_moves_as_prescribed_too(moving, speed, is_wall):
    """Of walls without their turning: a drum moves along itself."""
    from particlerb.case.to_system import to_system
    from particlerb.simulation.run import prepare

    bodies = [sphere("rests", position=[3.0, 0, R])]
    wall = plane(motion=moving) if is_wall else plane()
    if not is_wall:
        bodies.append(sphere("driven", position=[0, 0, R], motion=moving))
    elif "angular_velocity" in moving:
        speed = 0.0
    run = {"t_end": 1.0, "every": 1.0}
    scene = {"run": run, "body": bodies, "contact": impulse(0.3), "wall": [wall]}
    (group,) = prepare(to_system(scene)).plan.groups
    expected = 0.1 * R / speed if speed else 1.0
    assert group.segments[0].dt == pytest.approx(expected, rel=1e-9)
