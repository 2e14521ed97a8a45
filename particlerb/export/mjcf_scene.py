"""A whole scene as an MJCF model of MuJoCo: bodies where they start, joints, contact, gravity.

Joints of a spanning tree become joints of nested bodies, whose coordinates are those of
docs/joints.md; each other one closes a loop, and becomes an equality `connect` (a hinge two, on its
axis) or `weld`, which MuJoCo keeps softly. A distance is an equality of a tendon; a gear and
a rack are one of the coordinates by which both bodies move against a third, a screw of its own two.
Universal, cylindrical, planar joints, screws and sliders close no loop: they come first.

Contact with `hooke` is MuJoCo's reference acceleration -k r/m - c v/m, r the gap, of a body of mass
m against what does not move, at so small an impedance that it acts as a spring; between two bodies
it is softer, by m_eff/m. Other laws become a critically damped contact, as stiff as the step bears.
A box has planes as faces, which go on beyond its edges. Springs become tendons.

What acts along joints of the tree: mjcf_joints.py.

Source: mujoco.readthedocs.io, XML reference, and «Solver parameters» for `solref` and `solimp`.
Joints of a body act in the order in which they stand, the last one next to the body.
"""

import math
import re
from collections import deque
from collections.abc import Sequence
from typing import Final, NamedTuple
from xml.etree import ElementTree as ET

import numpy as np

from particlerb.contact.sphere_search import bodies_of_keys
from particlerb.export import ExportError
from particlerb.export.bodies import COMMENT, add_spheres, numbers, possible
from particlerb.export.mjcf_joints import Joint, freedoms, joint_at_start, laws_of
from particlerb.export.mjcf_walls import geoms_of
from particlerb.export.scene import FREE_STEP, left_out, springs_of
from particlerb.forces.links import WORLD
from particlerb.geometry.particles import kind_of
from particlerb.maths.vec3 import Floats
from particlerb.model import state
from particlerb.model.system import System
from particlerb.plan.contact_setup import NOTHING, SystemContact, contact_of
from particlerb.plan.joints import joints_of
from particlerb.rotors.rotor_class import NAMES, POINT, ROD

_TREE_ONLY_TYPES: Final = ("slider", "cylindrical", "universal", "planar", "screw")
_RATIO_TYPES: Final = ("gear", "rack")
_SOFT_TIME_STEPS: Final = 2.0  # time constant of what is kept softly: the least MuJoCo takes
_HELD_BODY: Final = -2  # in place of a joint, of bodies that stay where they are
_FREE_BODY: Final = -1  # in place of a joint, of bodies that nothing holds
_RIGID_SOLIMP: Final = "0.9999 0.9999 0.001 0.5 2"  # of contacts that hold what presses them
_SPRING_SOLIMP: Final = "0.01 0.01 0.001 0.5 2"  # of springs, within 1 %, whose friction holds
_SPRING_IMPRATIO: Final = 100.0  # against creeping where contacts are springs


class _Body(NamedTuple):
    """Where a body is, world frame; also the world."""

    position: Floats
    orientation: Floats
    velocity: Floats
    spin: Floats

    def turned_back(self, v: Floats) -> Floats:
        """A vector of the world in the frame of the body."""
        return state.rotate_back(self.orientation, v)

    def local(self, x: Floats) -> Floats:
        """A point of the world in the frame of the body."""
        return self.turned_back(x - self.position)

    def speed_at(self, x: Floats) -> Floats:
        """Velocity of its point at x."""
        return self.velocity + np.cross(self.spin, x - self.position)


def mjcf_scene(system: System, step: float = FREE_STEP) -> str:
    """MJCF text of a system made ready, with a keyframe `start` that has its speeds.

    Parameters
    ----------
    system : System
    step : float
        Step of the model [s].

    Raises
    ------
    ExportError
        If a body has no three positive moments or moves as prescribed, a loop closes by a joint, or
        bodies touch a wall, that MuJoCo has not, wheels do not turn on one body, or contact differs
        from pair to pair.
    """
    for body in system.body:
        if body.motion is not None:
            raise ExportError(f"{body.name} moves as prescribed, which is not written")
    thin = np.isin(system.bodies.rotor_class, (POINT, ROD)) & ~system.is_held
    for b in np.flatnonzero(thin).tolist():
        kind = NAMES[int(system.bodies.rotor_class[b])]
        raise ExportError(f"{system.names[b]} is a {kind}: MuJoCo needs three positive moments")
    return _Writer(system, step).text()


class _Writer:
    """The model as it grows."""

    def __init__(self, system: System, step: float) -> None:
        self.system, self.step = system, step
        q = state.body_orientation(system.state.q, system.bodies.rotor_frame)
        v = system.state.p * system.bodies.inv_mass
        w = state.omega_world(system.bodies, system.state)
        columns = (system.state.com.T, q.T, v.T, w.T)
        self.bodies = [_Body(*rows) for rows in zip(*columns, strict=True)]
        self.bodies.append(_Body(np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3)))
        setup, self.contact = joints_of(system), contact_of(system)
        n_joints = 0 if setup is None else len(setup.names)
        self.joints = [joint_at_start(system, setup, j) for j in range(n_joints) if setup]
        self.speeds: dict[str, list[float]] = {}  # by the names of bodies
        self.coordinates: dict[tuple[str, str], str] = {}  # by those of joints, and kinds
        self.root = ET.Element("mujoco", model=system.title or "scene")
        self.soft = {"solref": numbers(_SOFT_TIME_STEPS * step, 1.0)}
        self.tree = self.spanning_tree()
        self.laws = self.joint_laws()
        acting = {(self.joints[j].record, key) for j, laws in self.laws.items() for key in laws}
        missing = [f"left out: {line}" for line in left_out(system, springs_of(system), acting)]
        texts = (re.sub("-(?=-)", "- ", line) for line in (COMMENT, *missing))  # as XML asks
        self.root.extend(ET.Comment(f" {text} ") for text in texts)
        ET.SubElement(self.root, "compiler", angle="radian")
        options = {"timestep": numbers(step), "gravity": numbers(system.acceleration)}
        options |= {"integrator": "RK4" if self.contact is None else "implicitfast"}
        self.option = ET.SubElement(self.root, "option", options, cone="elliptic")
        default = ET.SubElement(self.root, "default")
        self.geoms = ET.SubElement(default, "geom", contype="0", conaffinity="0")
        self.world = ET.SubElement(self.root, "worldbody")
        self.elements, self.tendons = {WORLD: self.world}, ET.Element("tendon")
        self.actuators = ET.Element("actuator")
        if self.contact is not None:
            self.add_contact(self.contact)

    def text(self) -> str:
        """The whole model."""
        for b, (parent, j) in self.tree.items():
            self.add_body(b, parent, j)
        used = {j for _, j in self.tree.values()}
        rest = [one for j, one in enumerate(self.joints) if j not in used or one.type == "screw"]
        if rest:
            self.add_equalities(rest)
        self.add_springs()
        self.root.extend((self.tendons, self.actuators))
        keys = ET.SubElement(self.root, "keyframe")
        ET.SubElement(keys, "key", name="start", qvel=numbers(self.qvel()))
        try:
            ET.indent(self.root)
            return ET.tostring(self.root, encoding="unicode") + "\n"
        except RecursionError:
            raise ExportError("too many bodies hang one from the other for an MJCF file") from None

    def joint_laws(self) -> dict[int, dict[str, dict[str, str]]]:
        """What acts along joints of the tree, of records of the case that have no others."""
        used = {j for _, j in self.tree.values()}
        open_records = {one.record for j, one in enumerate(self.joints) if j not in used}
        chosen = ((j, one) for j, one in enumerate(self.joints) if one.record not in open_records)
        return {j: laws_of(one.table, self.soft["solref"]) for j, one in chosen}

    def qvel(self) -> Floats:
        """Speeds of all joints in the order of the bodies in the model."""
        bodies = self.world.iter("body")
        return np.concatenate([self.speeds[str(body.get("name"))] for body in bodies])

    def spanning_tree(self) -> dict[int, tuple[int, int]]:
        """Parent of each body, and the number of the joint with it, or no joint; parents first."""
        kept: dict[int, list[tuple[int, int]]] = {}
        label = {b: b for b in range(WORLD, self.system.n_bodies)}
        for b in np.flatnonzero(self.system.is_held).tolist():
            label[b] = WORLD
            kept.setdefault(WORLD, []).append((b, _HELD_BODY))
        ranks = [0 if joint.type in _TREE_ONLY_TYPES else 1 for joint in self.joints]
        for j in np.argsort(ranks, kind="stable").tolist():
            one = self.joints[j]
            if one.type in ("distance", *_RATIO_TYPES) or label[one.first] == label[one.second]:
                continue
            old, new = label[one.first], label[one.second]
            label = {b: new if mark == old else mark for b, mark in label.items()}
            kept.setdefault(one.first, []).append((one.second, j))
            kept.setdefault(one.second, []).append((one.first, j))
        tree: dict[int, tuple[int, int]] = {}
        seen: set[int] = set()
        for root in range(WORLD, self.system.n_bodies):
            if root in seen:
                continue
            ahead = deque([root])
            seen.add(root)
            if root != WORLD:
                tree[root] = WORLD, _FREE_BODY
            while ahead:
                b = ahead.popleft()
                for other, j in kept.get(b, ()):
                    if other not in seen:
                        seen.add(other)
                        tree[other] = b, j
                        ahead.append(other)
        return tree

    def add_body(self, b: int, parent: int, j: int) -> None:
        """Add a body to the one that it hangs from."""
        body, other = self.bodies[b], self.bodies[parent]
        place = numbers(other.local(body.position))
        back = other.orientation * state.CONJUGATE[:, 0]
        turned = numbers(state.quaternion_product(back, body.orientation))
        name = self.system.names[b]
        element = ET.SubElement(self.elements[parent], "body", name=name, pos=place, quat=turned)
        self.elements[b] = element
        position, _, radius, _ = kind_of(self.system.particles, int(self.system.kind[b]))
        add_spheres(element, position, radius, self.touch(b))
        if j == _HELD_BODY:
            self.speeds[name] = []
            return
        bodies = self.system.bodies
        mass, axes = numbers(bodies.mass[b]), numbers(bodies.rotor_frame[:, b])
        inertial = {"pos": "0 0 0", "mass": mass, "quat": axes}
        moments = numbers(possible(bodies.inertia[:, b]))
        ET.SubElement(element, "inertial", inertial, diaginertia=moments)
        if j == _FREE_BODY:
            ET.SubElement(element, "freejoint")  # a joint may have the name of a body
            self.speeds[name] = [*body.velocity.tolist(), *body.turned_back(body.spin).tolist()]
        else:
            self.speeds[name] = self.add_joints(element, b, parent, self.joints[j])
            for key, law in self.laws.get(j, {}).items():
                joint = element.find("joint")
                assert joint is not None
                if key == "motor":
                    joint = ET.SubElement(self.actuators, "general", joint=self.joints[j].name)
                joint.attrib.update(law)

    def touch(self, b: int) -> dict[str, str]:
        """What makes a geom of a body touch others, if it does, and how stiffly."""
        if self.contact is None or self.contact.material[b] == NOTHING:
            return {}
        text = {"contype": "1", "conaffinity": "1"}
        if self.contact.record.law == "hooke":
            stiffness = float(self.contact.pairs.stiffness.max()) * self.system.bodies.inv_mass[b]
            damping = 2.0 * float(self.contact.pairs.damping_ratio.max()) * math.sqrt(stiffness)
            text["solref"] = numbers(-stiffness, -damping)
        return text

    def add_contact(self, contact: SystemContact) -> None:
        """What holds for all geoms that touch; walls have no stiffness: that of bodies counts."""
        pairs = contact.pairs
        for name, values in pairs._asdict().items():
            if name != "can_meet" and np.unique(values[pairs.can_meet]).size > 1:
                raise ExportError(f"{name} differs from pair to pair: in MJCF a body has one")
        self.geoms.set("friction", numbers(pairs.friction.max(), 0.0, 0.0))
        self.geoms.attrib.update(self.soft)
        is_spring = contact.record.law == "hooke"
        self.geoms.set("solimp", _SPRING_SOLIMP if is_spring else _RIGID_SOLIMP)
        if is_spring:
            self.option.set("impratio", numbers(_SPRING_IMPRATIO))
        for wall in self.system.wall:
            for k, text in enumerate(geoms_of(wall)):
                name = wall.name + (f" {k}" if k else "")
                ET.SubElement(self.world, "geom", text, name=name, contype="1", conaffinity="1")
        if contact.excluded.size:
            excluded = ET.SubElement(self.root, "contact")
            for pair in zip(*bodies_of_keys(contact.excluded), strict=True):
                a, b = (self.system.names[k] for k in pair)
                ET.SubElement(excluded, "exclude", body1=a, body2=b)

    def add_joints(self, element: ET.Element, b: int, parent: int, joint: Joint) -> list[float]:
        """Add what a joint of the tree leaves free; its speeds."""
        body, other = self.bodies[b], self.bodies[parent]
        is_first = b == joint.first
        sign = 1.0 if is_first else -1.0
        moved = body.speed_at(joint.at) - other.speed_at(joint.at)
        spin = body.spin - other.spin
        place = numbers(body.local(joint.at))
        if joint.type == "ball":
            ET.SubElement(element, "joint", name=joint.name, type="ball", pos=place)
            return list(body.turned_back(spin).tolist())
        speeds = []
        for k, (kind, axis) in enumerate(freedoms(joint)[:: 1 if is_first else -1]):
            along, name = sign * axis, joint.name + (f" {k}" if k else "")
            text = numbers(body.turned_back(along))
            ET.SubElement(element, "joint", name=name, type=kind, pos=place, axis=text)
            self.coordinates[joint.name, kind] = name
            speeds.append(float(along @ (spin if kind == "hinge" else moved)))
        return speeds

    def add_equalities(self, joints: Sequence[Joint]) -> None:
        """Constraints that close loops, and distances."""
        equality, soft = ET.SubElement(self.root, "equality"), self.soft
        for joint in joints:
            if joint.type in _RATIO_TYPES or (joint.name, "slide") in self.coordinates:
                names, factor = self.coupled(joint)
                coordinates = dict(zip(("joint1", "joint2"), names, strict=True))
                text = numbers(0.0, factor, 0.0, 0.0, 0.0)
                ET.SubElement(equality, "joint", soft | coordinates, name=joint.name, polycoef=text)
                continue
            if joint.type in _TREE_ONLY_TYPES:
                told = f"closes a loop: MuJoCo has no {joint.type} for that"
                raise ExportError(f"{joint.name} {told}")
            ends = {"body1": self.system.names[joint.first]}
            if joint.second != WORLD:
                ends["body2"] = self.system.names[joint.second]
            if joint.type == "distance":
                placed = (joint.first, joint.at), (joint.second, joint.at_to)
                self.add_tendon([(b, self.bodies[b].local(x)) for b, x in placed], joint.name)
                ET.SubElement(equality, "tendon", soft, tendon1=joint.name)
            elif joint.type == "fixed":
                ET.SubElement(equality, "weld", soft | ends, name=joint.name)
            else:
                arm = joint.axis * np.linalg.norm(joint.at - self.bodies[joint.first].position)
                points = [joint.at] if joint.type == "ball" else [joint.at - arm, joint.at + arm]
                for x in points:
                    anchor = numbers(self.bodies[joint.first].local(x))
                    ET.SubElement(equality, "connect", soft | ends, anchor=anchor)

    def coupled(self, joint: Joint) -> tuple[tuple[str, str], float]:
        """Two coordinates, and the first over the second, of a gear, a rack or a screw."""
        if joint.type == "screw":
            names = self.coordinates[joint.name, "slide"], self.coordinates[joint.name, "hinge"]
            return names, -joint.radius
        kind, way = ("hinge", joint.axis) if joint.type == "gear" else ("slide", joint.axis_to)
        mine = self.movers(joint.first, "hinge", joint.axis)
        other = self.movers(joint.second, kind, way)
        for carrier in mine.keys() & other.keys():
            (one, sign), (two, other_sign) = mine[carrier], other[carrier]
            factor = -joint.radius if joint.type == "gear" else 1.0 / joint.radius
            return (one, two), factor * sign * other_sign
        raise ExportError(
            f"{joint.name} is a {joint.type}, and no third body has both of its bodies on hinges,"
            " or one on a slider, that MuJoCo keeps in its tree"
        )

    def movers(self, b: int, kind: str, way: Floats) -> dict[int, tuple[str, float]]:
        """Coordinates of joints of a body, by the body at the other end, and shares along a way."""
        coordinates = {}
        for joint in self.joints:
            name = self.coordinates.get((joint.name, kind))
            if name and joint.type in ("hinge", "slider") and b in (joint.first, joint.second):
                sign = float(joint.axis @ way) * (1.0 if b == joint.first else -1.0)
                coordinates[joint.second if b == joint.first else joint.first] = name, sign
        return coordinates

    def add_springs(self) -> None:
        """Add a tendon for each spring."""
        for link in springs_of(self.system):
            law = {key: numbers(getattr(link.force, key)) for key in ("stiffness", "damping")}
            for s, rest in enumerate(link.rest_length):
                ends = [(link.body_a[s], link.at_a[:, s]), (link.body_b[s], link.at_b[:, s])]
                name = f"force[{link.number}] {s}"
                self.add_tendon(ends, name, springlength=numbers(rest), **law)

    def add_tendon(self, ends: Sequence[tuple[int, Floats]], name: str, **law: str) -> None:
        """Add a tendon between points of two bodies, or of the world, in their frames."""
        spatial = ET.SubElement(self.tendons, "spatial", law, name=name)
        for (b, x), end in zip(ends, "ab", strict=True):
            ET.SubElement(self.elements[b], "site", name=f"{name} {end}", pos=numbers(x))
            ET.SubElement(spatial, "site", site=f"{name} {end}")
