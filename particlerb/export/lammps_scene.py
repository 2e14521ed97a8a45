"""A whole scene as an input that LAMMPS runs: bodies, gravity, contact and walls.

Bodies of several particles are those of `fix rigid/nve/small` with mass, centre, tensor, velocity
and angular momentum from an infile; balls are spheres of `fix nve/sphere`, points small ones, and
fixed bodies are integrated by nothing. Contact is `pair_style granular` with the dashpot of docs/
contact.md: there `coeff_restitution` means the ratio of damping ζ of contacts that attract,
e = exp(-πζ/√(1 - ζ²)), and `limit_damping` ends the attraction.

Source: docs.lammps.org for the commands; weight that acts on the atoms of a body would act at the
centre of its atoms, which is why the rigid fix takes it (keyword gravity).
"""

import math
import shlex
from collections.abc import Iterable, Sequence
from typing import Any, Final

import numpy as np

from particlerb.case.contact import AnyWall, BoxWall, CylinderWall, PlaneWall
from particlerb.contact.law import TANGENTIAL_DAMPING
from particlerb.export import ExportError
from particlerb.export.bodies import COMMENT, SMALLEST, carriers, numbers, six
from particlerb.export.scene import left_out, tethers_of
from particlerb.geometry.particles import kind_of
from particlerb.maths.vec3 import Bools, Floats, Ints
from particlerb.model.state import body_orientation, omega_world, rotate
from particlerb.model.system import System
from particlerb.plan.contact_setup import NOTHING, SystemContact, contact_of
from particlerb.rotors.rotor_class import POINT

_FACES: Final = {"-x": 1, "+x": 2, "-y": 3, "+y": 4, "-z": 5, "+z": 6, "-": 1, "+": 2}
_SKIN_SHARE: Final = 0.3  # of the largest radius: skin of the lists of neighbours
_MIN_RADIUS_SHARE: Final = 0.5  # of the room that each atom has: else lists have too many cells
_MAX_GROUPS: Final = 31  # beside `all`
_BALL_TOLERANCE: Final = 1e-12  # how well 2/5 m R² is met by a ball, relative


def lammps_scene(system: System, step: float, stem: str) -> dict[str, str]:
    """Texts of the files of a scene, by suffix: the input, its atoms, and its rigid bodies.

    Parameters
    ----------
    system : System
        Made ready.
    step : float
        Step of the run [s].
    stem : str
        Name of the files without suffix, by which the input calls the others.

    Raises
    ------
    ExportError
        If joints, a wall, a motion, a law of contact or a name is one that LAMMPS does not have.
    """
    contact = contact_of(system)
    _refuse(system, contact)
    atoms = _Atoms(system, contact)
    lines = _input(system, contact, atoms, step, stem)
    groups = {line.split()[1] for line in lines if line.startswith("group ")}
    if len(groups) > _MAX_GROUPS:
        raise ExportError(f"a group for each spring makes {len(groups)}: LAMMPS has {_MAX_GROUPS}")
    texts = {".in": "\n".join(lines) + "\n", ".data": atoms.data()}
    if atoms.is_rigid.any():
        texts[".rigid"] = _infile(system, np.flatnonzero(atoms.is_rigid))
    return texts


def _refuse(system: System, contact: SystemContact | None) -> None:
    """ExportError for what is not to be had in LAMMPS."""
    if system.joint:
        raise ExportError("LAMMPS has no joints: `--to mjcf` writes them for MuJoCo")
    for record in (*system.body, *system.wall):
        if record.motion is not None or getattr(record, "piston", None) is not None:
            raise ExportError(f"{record.name} moves as prescribed, which is not written")
    if contact is None:
        return
    if not contact.record.has_stiffness:
        raise ExportError(f'contact.law = "{contact.record.law}": LAMMPS has hooke and hertz')
    if (contact.pairs.damping_ratio >= 1.0).any():
        raise ExportError("a restitution that needs overdamping: LAMMPS has none below e^-2")
    for wall in system.wall:
        if not isinstance(wall, PlaneWall | BoxWall | CylinderWall):
            raise ExportError(f"{wall.name} is a mesh: walls become planes, boxes, cylinders")
        if isinstance(wall, CylinderWall) and np.count_nonzero(wall.axis) != 1:
            raise ExportError(f"{wall.name}: a cylinder of LAMMPS lies along x, y or z")


class _Atoms:
    """Spheres of all bodies, or their masses where they have no radius, in the world frame."""

    def __init__(self, system: System, contact: SystemContact | None) -> None:
        bodies, n = system.bodies, system.n_bodies
        q = body_orientation(system.state.q, bodies.rotor_frame)
        masses = system.properties.mass.tolist()
        per_kind = [carriers(kind_of(system.particles, k), mass) for k, mass in enumerate(masses)]
        sizes = np.array([len(particles.mass) for particles in per_kind])[system.kind]
        body: Ints = np.repeat(np.arange(n), sizes)
        columns = zip(*(per_kind[k][:3] for k in system.kind.tolist()), strict=True)
        local, mass, radius = map(np.concatenate, columns)
        single = _are_single(system, sizes, radius[np.cumsum(sizes) - 1])
        self.is_held: Bools = system.is_held
        self.is_single: Bools = single & ~self.is_held
        self.is_rigid: Bools = ~single & ~self.is_held
        lone = np.flatnonzero(self.is_rigid & (sizes == 1))  # a rigid body is two atoms at least
        self.body = np.append(body, lone)
        aside = 0.1 * radius[np.isin(body, lone), None] * [1.0, 0.0, 0.0]
        local = np.append(local, aside, axis=0)
        self.mass: Floats = np.append(mass, system.bodies.mass[lone])
        radius = np.append(radius, np.zeros(lone.size))
        self.place: Floats = (rotate(q[:, self.body], local.T) + system.state.com[:, self.body]).T
        extent = max(float(system.reach.max()), 1e-3)
        self.diameter: Floats = np.where(radius > 0.0, 2.0 * radius, SMALLEST * extent)
        room = max(extent, float(np.ptp(self.place, axis=0).max())) / len(self.place) ** (1.0 / 3.0)
        self.skin = _SKIN_SHARE * max(float(radius.max()), _MIN_RADIUS_SHARE * room)
        velocity = (system.state.p * bodies.inv_mass).T
        spin = omega_world(bodies, system.state).T
        arm = self.place - system.state.com.T[self.body]
        self.velocity: Floats = velocity[self.body] + np.cross(spin[self.body], arm)
        self.spin: Floats = spin[self.body]
        material = np.full(n, NOTHING) if contact is None else contact.material
        self.n_materials = 0 if contact is None else len(contact.materials)
        untouched = self.n_materials + 1
        type_of = np.where(material == NOTHING, untouched, material + 1)
        self.type: Ints = np.where(radius > 0.0, type_of[self.body], untouched)
        self.n_types = max(int(self.type.max()), self.n_materials)

    def data(self) -> str:
        """Data file, `atom_style sphere`, with the number of its body for each atom."""
        low, high = self.place.min(axis=0), self.place.max(axis=0)
        room = float(self.diameter.max()) + self.skin
        density = self.mass / (math.pi / 6.0 * self.diameter**3)
        edges = zip("xyz", low - room, high + room, strict=True)
        rows = zip(
            self.type.tolist(), self.diameter, density, self.place,
            np.concatenate([self.velocity, self.spin], axis=1), self.body.tolist(), strict=True,
        )  # fmt: skip
        places, motions, molecules = [], [], []
        for k, (kind, diameter, rho, x, motion, body) in enumerate(rows, 1):
            places.append(f"{k} {kind} {numbers(diameter, rho, x)}")
            motions.append(f"{k} {numbers(motion)}")
            molecules.append(f"{k} {body + 1}")
        sections = [
            f"# {COMMENT}",
            f"{len(self.body)} atoms\n{self.n_types} atom types",
            "\n".join(f"{numbers(a, b)} {axis}lo {axis}hi" for axis, a, b in edges),
            *("Atoms # sphere", "\n".join(places), "Velocities", "\n".join(motions)),
            *("Molecules", "\n".join(molecules)),
        ]
        return "\n\n".join(sections) + "\n"

    def molecules(self, chosen: Bools) -> str:
        """Numbers of bodies as ranges for the command `group`."""
        ids = np.flatnonzero(chosen) + 1
        breaks = np.flatnonzero(np.diff(ids) > 1)
        firsts, lasts = ids[np.append(0, breaks + 1)], ids[np.append(breaks, ids.size - 1)]
        return " ".join(f"{a}:{b}" for a, b in zip(firsts, lasts, strict=True))


def _are_single(system: System, sizes: Ints, radius: Floats) -> Bools:
    """Which bodies are a ball or a point."""
    of_ball = 0.4 * system.bodies.mass * radius**2
    is_ball = (np.abs(system.bodies.inertia - of_ball) <= _BALL_TOLERANCE * of_ball).all(axis=0)
    single: Bools = (sizes == 1) & (is_ball | (system.bodies.rotor_class == POINT))
    return single


def _infile(system: System, bodies: Ints) -> str:
    """Rows of rigid bodies: id, mass, centre, tensor, velocity, angular momentum, image flags."""
    state = system.state
    axes = [rotate(state.q[:, bodies], e[:, None]) for e in np.eye(3)]
    R = np.stack(axes, axis=1).transpose(2, 0, 1)
    tensors = np.einsum("nij,jn,nkj->nik", R, system.bodies.inertia[:, bodies], R)
    lines = [f"# {COMMENT}; world frame", str(len(bodies))]
    for b, tensor in zip(bodies.tolist(), tensors, strict=True):
        mass = system.bodies.mass[b]
        velocity = state.p[:, b] / mass
        row = numbers(mass, state.com[:, b], six(tensor), velocity, state.L[:, b])
        lines.append(f"{b + 1} {row} 0 0 0")
    return "\n".join(lines) + "\n"


def _input(
    system: System, contact: SystemContact | None, atoms: _Atoms, step: float, stem: str
) -> list[str]:
    """Commands of the run."""
    reach = 2.0 * float(system.reach.max()) + atoms.skin
    masks = {"rigid": atoms.is_rigid, "single": atoms.is_single, "held": atoms.is_held}
    excluded = ["molecule/intra all"] if len(atoms.body) > 1 else []
    excluded += ["group held held"] if atoms.is_held.any() else []
    return [
        _comment(f"{system.title or stem}: {COMMENT}"),
        *(_comment(f"left out: {line}") for line in left_out(system, tethers_of(system))),
        *("units si", "atom_style sphere", "atom_modify map yes", "newton off", "boundary m m m"),
        f"comm_modify vel yes cutoff {numbers(reach)}",
        "fix body all property/atom mol",
        f"read_data {_file(stem, '.data')} fix body NULL Molecules",
        *(f"group {g} molecule {atoms.molecules(mask)}" for g, mask in masks.items() if mask.any()),
        *_pairs(contact, atoms),
        f"neighbor {numbers(atoms.skin)} bin",
        "neigh_modify delay 0 every 1 check yes",
        *(f"neigh_modify exclude {pairs}" for pairs in excluded),
        *_walls(system, contact),
        *_tethers(system),
        *_integration(system, atoms, stem),
        f"timestep {numbers(step)}",
        *_output(system, atoms, step, stem),
        f"run {round(system.run.t_end / step)}",
    ]


def _comment(text: str) -> str:
    """A comment in one line, which no `&` at its end joins to the next."""
    return f"# {' '.join(text.split())}".rstrip("& ")


def _file(stem: str, suffix: str) -> str:
    """Name of a file as one word; ExportError where LAMMPS cannot take it as it is."""
    if {"'", '"'} <= set(stem) or set("*%\n") & set(stem):
        reason = "LAMMPS takes no names with *, %, a line break or both kinds of quotes"
        raise ExportError(f"{stem!r}: {reason}: give another name")
    return f'"{stem}{suffix}"' if "'" in stem else shlex.quote(stem + suffix)


def _law(contact: SystemContact, a: int, b: int) -> str:
    """Arguments of a granular contact between two materials."""
    pairs = contact.pairs
    ratio = float(pairs.damping_ratio[a, b])
    restitution = math.exp(-math.pi * ratio / math.sqrt(1.0 - ratio * ratio))
    if contact.record.law == "hertz":
        normal = f"hertz {numbers(4.0 / 3.0 * pairs.modulus[a, b], restitution)}"
        tangential = f"mindlin {numbers(8.0 * pairs.shear_modulus[a, b])}"
    else:
        normal = f"hooke {numbers(pairs.stiffness[a, b], restitution)}"
        tangential = f"linear_history {numbers(pairs.tangential_stiffness[a, b])}"
    friction = numbers(TANGENTIAL_DAMPING, pairs.friction[a, b])
    ends = "" if contact.record.attract else " limit_damping"
    return f"{normal} tangential {tangential} {friction} damping coeff_restitution{ends}"


def _pairs(contact: SystemContact | None, atoms: _Atoms) -> Iterable[str]:
    """Forces between atoms; those of no material touch nothing."""
    if contact is None:
        return [f"pair_style zero {numbers(atoms.skin)} nocoeff", "pair_coeff * *"]
    apart = [t for t in range(1, atoms.n_types + 1) if t > atoms.n_materials]
    can_meet = contact.pairs.can_meet
    met = [tuple(two) for two in np.argwhere(np.triu(can_meet)).tolist()]
    first = _law(contact, *met[0])
    return [
        "pair_style granular",
        f"pair_coeff * * {first}",
        *(f"pair_coeff {a + 1} {b + 1} {_law(contact, a, b)}" for a, b in met[1:]),
        *(f"neigh_modify exclude type {t} {u}" for t in apart for u in range(1, t + 1)),
    ]


def _walls(system: System, contact: SystemContact | None) -> Iterable[str]:
    """A region for each wall, and a fix for each material that touches it."""
    if contact is None:
        return
    for code in sorted(set(contact.material[contact.material != NOTHING].tolist())):
        yield f"group material{code + 1} type {code + 1}"
    walls = zip(system.wall, contact.wall_material.tolist(), strict=True)
    for k, (wall, material) in enumerate(walls, 1):
        yield f"region wall{k} {_region(wall)}  {_comment(wall.name)}"
        for code in np.flatnonzero(contact.pairs.can_meet[material]).tolist():
            law = f"granular {_law(contact, code, material)} region wall{k}"
            if (contact.material[~contact.fixed] == code).any():
                yield f"fix wall{k}_{code + 1} material{code + 1} wall/gran/region {law}"


def _region(wall: AnyWall) -> str:
    """Arguments of a region that is touched from the side on which bodies are."""
    if isinstance(wall, PlaneWall):
        return f"plane {numbers(wall.point, wall.normal)} side in units box"
    side = "side in" if wall.inside else "side out"  # type: ignore[union-attr]
    opened = "".join(f" open {_FACES[face]}" for face in wall.open)  # type: ignore[union-attr]
    if isinstance(wall, BoxWall):
        edges = numbers(np.column_stack([wall.lower, wall.upper]).reshape(-1))
        return f"block {edges} {side} units box{opened}"
    assert isinstance(wall, CylinderWall)
    along = int(np.flatnonzero(wall.axis)[0])
    if wall.axis[along] < 0.0:
        opened = "".join(f" open {3 - _FACES[face]}" for face in wall.open)
    across = [wall.centre[i] for i in range(3) if i != along]
    ends = wall.centre[along] + 0.5 * wall.length * np.array([-1.0, 1.0])
    return f"cylinder {'xyz'[along]} {numbers(across, wall.radius, ends)} {side} units box{opened}"


def _tethers(system: System) -> Iterable[str]:
    """Springs from centres to the world."""
    for link in tethers_of(system):
        ends = zip(link.body_a.tolist(), link.at_b.T, link.rest_length, strict=True)
        for b, anchor, rest in ends:
            name = f"spring{link.number}_{b + 1}"
            yield f"group {name} molecule {b + 1}"
            values = numbers(link.force.stiffness, anchor, rest)
            yield f"fix {name} {name} spring tether {values}"


def _integration(system: System, atoms: _Atoms, stem: str) -> Iterable[str]:
    """Weight, and how bodies move; weight stands first, or a first half step would miss it."""
    g = system.acceleration
    size = float(np.linalg.norm(g))
    weight = f"gravity {numbers(size)} vector {numbers(g)}"
    if atoms.is_single.any():
        if size:
            yield f"fix weight single {weight}"
        yield "fix balls single nve/sphere"
    if atoms.is_rigid.any():
        if size:
            yield "# before 22 July 2025, update 2, the first half step misses this weight"
            yield f"fix pull rigid {weight} disable"
        pull = " gravity pull" if size else ""
        yield f"fix clumps rigid rigid/nve/small molecule infile {_file(stem, '.rigid')}{pull}"


def _output(system: System, atoms: _Atoms, step: float, stem: str) -> Sequence[str]:
    """Frames as text dumps: atoms, and centres and orientations of rigid bodies."""
    every: Any = max(1, round(system.run.every / step))
    frames, bodies = (_file(stem, suffix) for suffix in (".lammpstrj", ".bodies"))
    lines = [
        f"dump atoms all custom {every} {frames} id mol type radius x y z vx vy vz",
        "dump_modify atoms sort id format float %.17g",
        *("thermo_style custom step time atoms", f"thermo {every}"),
    ]
    if atoms.is_rigid.any():
        columns = "mol x y z quatw quati quatj quatk vx vy vz"
        rows = " ".join(f"c_bodies[{k + 1}]" for k in range(len(columns.split())))
        lines += [
            f"compute bodies all rigid/local clumps {columns}",
            f"dump bodies all local {every} {bodies} {rows}",
            "dump_modify bodies format float %.17g",
        ]
    return lines
