"""A force is a file and a table, a method a file and a name, as CONTRIBUTING.md says."""

import math
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import particlerb
from particlerb import tables
from particlerb.case.forces import FORCE_TABLES
from particlerb.forces.registry import FORCES, KICKS, TERMS, complete

PACKAGE = Path(particlerb.__file__).parent
PAGE = PACKAGE.parent / "CONTRIBUTING.md"
RUN = """
import sys
import numpy as np, particlerb
from particlerb.compiled.jit import CACHE_FOLDER
body = {"name": "body", "shape": {"type": "moments", "inertia": [1.0, 2.0, 2.5]}, "mass": 2.0,
        "velocity": [1.0, 0.0, 0.0], "angular_velocity": [0.3, 0.0, 0.2]}
run = {"t_end": 0.8, "every": 0.8, "method": sys.argv[1], "dt": float(sys.argv[2])}
toy = {"type": "toy", "body": "body", "pull": 3.0}
with particlerb.run({"run": run, "body": [body], "force": [toy]}) as t:
    print(*t.position[-1, 0], t.ledger.energy_error[-1], t.ledger.work[-1], CACHE_FOLDER)
    print(t.parameter("plan"))
"""


def example():
    """The two files and the table that CONTRIBUTING.md shows, by the path of the file."""
    text = PAGE.read_text(encoding="utf-8")
    text = text[text.index("## To add a force") :]
    pattern = r"`(particlerb/\S+\.py)`.*?```python\n(.*?)```"
    return dict(re.findall(pattern, text, re.DOTALL))


@pytest.fixture
def copy(tmp_path):
    """A copy of the package with the force and the method of CONTRIBUTING.md."""
    ignore = shutil.ignore_patterns("__pycache__")
    shutil.copytree(PACKAGE, tmp_path / "particlerb", ignore=ignore)
    parts = example()
    files = ["particlerb/forces/toy.py", "particlerb/integrators/yoshida4.py"]
    assert list(parts) == [files[0], "particlerb/case/forces.py", files[1]]
    for file in files:
        (tmp_path / file).write_text(parts[file])
    names = tmp_path / "particlerb/model/method_names.py"
    names.write_text(names.read_text().replace('"exact",', '"exact", "yoshida4",'))
    tables = tmp_path / "particlerb/case/forces.py"
    text = tables.read_text().replace("| MagnusTable ", "| MagnusTable | ToyTable ")
    head, tail = text.split("AnyForce = (")
    tables.write_text(f"{head}{parts['particlerb/case/forces.py']}\n\nAnyForce = ({tail}")
    return tmp_path


def run_copy(folder, method, cache, dt=0.1, **flags):
    """Numbers of the toy's run, the folder of compiled code, and the plan, by a copy."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_")}
    environment |= {"PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": str(cache), **flags}
    done = subprocess.run(
        [sys.executable, "-c", RUN, method, str(dt)],
        capture_output=True,
        text=True,
        check=False,
        env=environment,
        cwd=folder,
    )
    assert done.returncode == 0, done.stderr
    first, plan = done.stdout.split("\n", 1)
    *numbers, where = first.split()
    return [float(number) for number in numbers], where, plan


def test_the_force_of_the_page_acts_with_two_files(copy):
    """F = -k x from the world's origin: x = (v/ω) sin ω t, with ω² = k/M; energy is k x²/2."""
    numbers, _, plan = run_copy(copy, "dop853", copy / "cache", NUMBA_DISABLE_JIT="1")
    omega = (3.0 / 2.0) ** 0.5
    x, y, z, error, work = numbers
    assert x == pytest.approx(math.sin(omega * 0.8) / omega, abs=1e-9)
    assert (y, z) == (0.0, 0.0)
    assert work == pytest.approx(-1.5 * x * x, abs=1e-9)
    assert abs(error) < 1e-9
    assert "driven by pull to the origin" in plan
    assert re.search(r"toy +1 in the case", plan)


def test_the_method_of_the_page_has_its_order(copy):
    """Half the step has a sixteenth of the error."""
    omega = (3.0 / 2.0) ** 0.5
    errors = [
        abs(run_copy(copy, "yoshida4", copy / "cache", dt, NUMBA_DISABLE_JIT="1")[0][0] - x)
        for x in [math.sin(omega * 0.8) / omega]
        for dt in (0.2, 0.1)
    ]
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.1)


@pytest.mark.slow
@pytest.mark.compiled
def test_a_second_process_finds_the_kicks_in_the_cache(copy):
    """What is made from the registry is compiled once, whichever process made it."""
    first, where, _ = run_copy(copy, "strang", copy / "cache")
    made = {path: path.stat().st_mtime_ns for path in Path(where).rglob("*.nb?")}
    assert any(path.suffix == ".nbc" and "advance_strang" in path.name for path in made)
    again, there, _ = run_copy(copy, "strang", copy / "cache")
    assert (again, there) == (first, where)
    assert {path: path.stat().st_mtime_ns for path in Path(where).rglob("*.nb?")} == made


def test_every_table_has_a_force_and_every_name_is_there_once():
    assert list(FORCES) == list(FORCE_TABLES)
    assert {table.__name__ for table in FORCE_TABLES.values()} <= set(dir(tables))
    assert len({kick.name for kick in KICKS}) == len(KICKS)
    assert len({term.name for term in TERMS.values()}) == len(TERMS)
    assert sum(kick.damp is not None for kick in KICKS) == 1  # two would not commute


@pytest.mark.parametrize("name", ["magnus", "rotating_field"])
def test_a_force_that_some_method_would_leave_out_is_refused(name):
    kick = next(kick for kick in KICKS if kick.name == name)
    assert complete(kick) is kick
    with pytest.raises(TypeError, match=f"{name}: .* needs `(flow|power)`"):
        complete(kick._replace(flow=None, power=None))


def test_nobody_reads_a_case_with_the_compiler(make):
    case = make.case(make.body(), force=[make.push([0, 0, 1.0])])
    code = f"import sys, particlerb.case.reader as r; r.load({case!r}, ()); print(*sys.modules)"
    modules = make.python(code).split()
    assert "particlerb.case.forces" in modules
    assert "numba" not in modules
