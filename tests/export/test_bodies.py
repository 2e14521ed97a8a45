"""Bodies in the files of LAMMPS, MuJoCo, YADE and gsd, as these programs read them."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from particlerb.cli import main
from particlerb.export import ExportError
from particlerb.export.bodies import BODY_FORMATS, NamedBody, export_bodies
from particlerb.export.bodies import carriers as carriers_of
from particlerb.geometry.mass_properties import mass_properties
from particlerb.geometry.overlapping_spheres import spheres
from particlerb.geometry.particles import one_kind
from particlerb.model.bodies import quaternions

CENTRE = np.array([[0.1, 0.2, 0.3], [0.6, 0.3, 0.1], [0.2, 0.7, 0.4], [0.4, 0.1, 0.9]])
RADIUS = np.array([0.4, 0.35, 0.3, 0.25])


def clump():
    """A clump of overlapping spheres, oblique, off the origin."""
    particles = spheres(CENTRE, RADIUS, density=2500.0)
    return NamedBody("clump", particles, mass_properties(particles))


def cloud():
    rng = np.random.default_rng(2)
    particles = one_kind(rng.normal(size=(7, 3)), rng.random(7))
    return NamedBody("cloud", particles, mass_properties(particles))


def needle():
    particles = one_kind([[0, 0, 0], [1, 2, 3], [2, 4, 6]], 1.0)
    return NamedBody("needle", particles, mass_properties(particles))


def carriers(body):
    """Spheres, or masses, of an exported body."""
    return carriers_of(body.particles, body.properties.mass[0])


LAMMPS_SCENE = """
units si
atom_style sphere
atom_modify map yes
region box block -50 50 -50 50 -50 50
create_box 1 box
molecule body {path}
fix names all property/atom mol
pair_style zero 6.0
pair_coeff * *
comm_modify cutoff 8
thermo_style custom step
timestep 1e-9
"""
WHAT = "mass x y z inertiax inertiay inertiaz"


def atoms(engine, name):
    """A property of all atoms, in the order of the file."""
    own = engine.extract_setting("nlocal")
    order = np.argsort(engine.numpy.extract_atom("id")[:own])
    return np.array(engine.numpy.extract_atom(name)[:own])[order]


@pytest.mark.parametrize("make", [clump, cloud])
def test_lammps_pours_molecules_with_the_mass_and_moments_of_the_header(lammps, tmp_path, make):
    body = make()
    path, _ = export_bodies([body], tmp_path / "body.mol", "lammps")
    lammps.commands_string(LAMMPS_SCENE.format(path=path))
    lammps.commands_string(
        "region middle block -1 1 -1 1 -1 1\n"
        "fix rigid all rigid/small molecule mol body\n"
        "fix pour all deposit 1 0 1 4321 region middle mol body rigid rigid\n"
        f"compute bodies all rigid/local rigid {WHAT}\n"
        "run 2 post no"
    )
    found = np.array(lammps.numpy.extract_compute("bodies", 2, 2))[0]
    assert found[0] == pytest.approx(body.properties.mass[0], rel=1e-15)
    assert np.sort(found[4:7]) == pytest.approx(body.properties.moments[0], rel=1e-13)


@pytest.mark.parametrize("make", [clump, cloud])
def test_lammps_takes_mass_com_and_tensor_from_the_infile(lammps, tmp_path, make):
    body = make()
    mass, com, tensor, moments, axes, _ = (array[0] for array in body.properties)
    path, infile = export_bodies([body], tmp_path / "body.mol", "lammps")
    lammps.commands_string(LAMMPS_SCENE.format(path=path))
    lammps.command("create_atoms 0 single 0 0 0 mol body 1 rotate 0 0 0 1")
    place = (carriers(body).position - com) @ axes
    shift = place - atoms(lammps, "x")  # LAMMPS puts the middle of the atoms at the place
    lammps.command("displace_atoms all move {} {} {}".format(*shift[0]))
    assert np.abs(atoms(lammps, "x") - place).max() < 1e-14
    lammps.command(f"fix rigid all rigid/small molecule infile {infile}")
    lammps.command(f"compute bodies all rigid/local rigid {WHAT}")
    lammps.command("run 0 post no")
    found = np.array(lammps.numpy.extract_compute("bodies", 2, 2))[0]
    assert found[0] == pytest.approx(mass, rel=1e-15)
    assert np.abs(found[1:4]).max() < 1e-14
    assert np.sort(found[4:7]) == pytest.approx(moments, rel=1e-14)
    lammps.command("uncompute bodies")
    lammps.command("unfix rigid")

    # With the angular momentum I ω in the infile of fix rigid, atoms get ω × r: in body axes too.
    omega = np.array([0.3, -0.2, 0.5])
    lines = infile.read_text().splitlines()
    words = lines[-1].split()
    words[14:17] = [repr(float(number)) for number in (tensor @ omega) @ axes]
    infile.write_text("\n".join([*lines[:-1], " ".join(words)]) + "\n")
    lammps.command(f"fix rigid all rigid single infile {infile}")
    lammps.command("run 0 post no")
    expected = np.cross(omega, carriers(body).position - com)
    assert np.abs(atoms(lammps, "v") @ axes.T - expected).max() < 1e-13


def test_mujoco_has_the_mass_com_and_tensor_of_the_file(tmp_path):
    """By principal axes: MuJoCo 3.2 finds those of a full tensor to 3e-7 only."""
    mujoco = pytest.importorskip("mujoco")
    bodies = [clump(), cloud()]
    (path,) = export_bodies(bodies, tmp_path / "bodies.xml", "mjcf")
    assert path.read_text(encoding="utf-8").count("diaginertia=") == len(bodies)
    model = mujoco.MjModel.from_xml_path(str(path))
    for body in bodies:
        mass, com, tensor, *_ = (array[0] for array in body.properties)
        found = model.body(body.name)
        R = Rotation.from_quat(found.iquat, scalar_first=True).as_matrix()
        assert found.mass[0] == pytest.approx(mass, rel=1e-15)
        assert np.abs(found.ipos - com).max() < 1e-15
        kept = R @ np.diag(found.inertia) @ R.T
        assert np.abs(kept - tensor).max() < 1e-14 * np.trace(tensor)
    assert model.ngeom == len(RADIUS)
    assert np.abs(model.geom_size[:, 0] - RADIUS).max() == 0.0


def test_gsd_has_principal_axes_and_the_tensor_in_full(tmp_path):
    gsd = pytest.importorskip("gsd.hoomd")
    bodies = [clump(), cloud()._replace(name="Wolke ü")]
    (path,) = export_bodies(bodies, tmp_path / "bodies.gsd", "gsd")
    with gsd.open(path, "r") as file:
        frame = file[0]
    assert frame.particles.types == [body.name for body in bodies]
    for k, body in enumerate(bodies):
        mass, com, tensor, moments, axes, _ = (array[0] for array in body.properties)
        assert frame.particles.mass[k] == pytest.approx(mass, rel=1e-7)
        assert frame.particles.moment_inertia[k] == pytest.approx(moments, rel=1e-7)
        assert frame.particles.orientation[k] == pytest.approx(quaternions(axes[None])[0], abs=1e-7)
        assert frame.log["mass"][k] == mass
        assert (frame.log["com"][k] == com).all()
        assert (frame.log["inertia_tensor"][k] == tensor.ravel()).all()
    shape = frame.particles.type_shapes[0]
    axes = bodies[0].properties.axes[0]
    back = np.array(shape["centers"]) @ axes.T + bodies[0].properties.com[0]
    assert np.abs(back - CENTRE).max() < 1e-7
    assert frame.particles.type_shapes[1] == {}


def test_yade_clump_is_about_its_com_in_principal_axes(tmp_path):
    body = clump()
    (path,) = export_bodies([body], tmp_path / "clump.txt", "yade")
    lines = path.read_text().splitlines()
    facts = {line.split()[1]: line.split()[2:] for line in lines if line.startswith("# ")}
    rows = np.array([line.split() for line in lines if not line.startswith("#")], dtype=float)
    assert [float(facts["mass"][0])] == body.properties.mass.tolist()
    assert [float(x) for x in facts["inertia"]] == body.properties.moments[0].tolist()
    axes = np.array([float(x) for x in facts["axes"][:9]]).reshape(3, 3).T
    com = np.array([float(x) for x in facts["com"][:3]])
    assert np.abs(rows[:, :3] @ axes.T + com - CENTRE).max() < 1e-15
    assert rows[:, 3].tolist() == RADIUS.tolist()
    assert set(rows[:, 4]) == {0.0}


def test_carriers_are_the_spheres_with_the_mass_of_the_body():
    own = carriers(clump())
    assert own.position.tolist() == CENTRE.tolist()
    assert own.mass.sum() == pytest.approx(clump().properties.mass[0], rel=1e-15)
    assert own.mass == pytest.approx(own.mass.sum() * RADIUS**3 / (RADIUS**3).sum(), rel=1e-14)
    assert carriers(cloud()).mass.tolist() == cloud().particles.mass.tolist()


@pytest.mark.parametrize(
    ("bodies", "to", "message"),
    [
        ([clump(), cloud()], "lammps", "one body: name one of clump, cloud"),
        ([needle()], "mjcf", "needle is a rod: MuJoCo needs three positive moments"),
        ([cloud()], "yade", "cloud has no particle with a radius"),
    ],
)
def test_what_a_format_cannot_hold(tmp_path, bodies, to, message):
    with pytest.raises(ExportError, match=message):
        export_bodies(bodies, tmp_path / "body", to)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("to", BODY_FORMATS)
def test_command_exports_a_body_of_a_case(tmp_path, monkeypatch, capsys, to):
    monkeypatch.chdir(tmp_path)
    Path("scene.toml").write_text(
        "[run]\nt_end = 1.0\nevery = 1.0\n"
        "[[body]]\nname = 'stone'\ndensity = 2500.0\nshape = { type = 'spheres',"
        " position = [[0, 0, 0], [0.5, 0, 0], [0, 0.7, 0.1]], radius = 0.5 }\n"
    )
    command = ["export", "scene.toml", "--bodies", "stone", "--to", to]
    assert main(command) == 0
    written = [Path(name) for name in capsys.readouterr().out.split(": ")[1].strip().split(", ")]
    assert all(path.stat().st_size > 0 and path.stem == "stone" for path in written)
    assert main(command) == 2
    assert "exists" in capsys.readouterr().err
    assert main([*command, "--overwrite"]) == 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--to", "npz"], "bodies become lammps, mjcf, yade, gsd"),
        (["--to", "mjcf", "--frames", "0:3"], "for trajectories"),
        (["--to", "mjcf", "--bodies", "x"], "clump.txt is one body"),
        (["--to", "mjcf", "-o", "clump.txt"], "is the input"),
    ],
)
def test_command_refuses(tmp_path, monkeypatch, capsys, options, message):
    monkeypatch.chdir(tmp_path)
    Path("clump.txt").write_text("0 0 0 1\n1 0 0 1\n")
    assert main(["export", "clump.txt", *options]) == 2
    assert message in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["clump.txt"]
