"""An event-driven program for hard spheres, beside collisions by events: what a collision costs.

F. Smallenburg, *Efficient event-driven simulations of hard spheres*, Eur. Phys. J. E 45, 22 (2022),
measured it as four to ten times faster than others, DynamO among them. Its variant `Cell` finds
collisions by cells of a grid as ours does, which is what suits a dilute gas; it knows balls in a
box that repeats and nothing else. What it does is stated by numbers in its source: a copy with
other ones is compiled here. Whoever measures brings a checkout of github.com/FSmallenburg/EDMD.
"""

import math
import re
import resource
import shutil
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

FLAGS = ("-Ofast", "-funroll-loops", "-march=native")
"""Those of its Makefile."""
_BLOCK = 16.0
"""Events in a list of the calendar, and how far it reaches; of 1, 4 and 16 never the slowest."""


def _edited(source: str, numbers: dict[str, float]) -> str:
    """The source with other numbers."""
    for name, value in numbers.items():
        source, n = re.subn(rf"(double {name} = )[\d.]+;", rf"\g<1>{value!r};", source)
        assert n == 1, f"this version has no number {name}"
    return source


def _write_grid(path: Path, n: int, filling: float) -> None:
    """Balls of diameter 1 on a grid that fills the box."""
    length = (n * math.pi / 6.0 / filling) ** (1.0 / 3.0)
    side = math.ceil(round(n ** (1.0 / 3.0), 6))
    lines = [f"{n}", f"{length} {length} {length}"]
    for i in range(n):
        place = ((k + 0.5) * length / side for k in (i // side**2, i // side % side, i % side))
        lines.append(f"a {' '.join(f'{x:.12f}' for x in place)} 0.5")
    path.write_text("\n".join(lines) + "\n")


def _run(folder: Path, t_end: float, n: int, filling: float) -> tuple[float, int]:
    """Processor time of a run [s], and its collisions; velocities have a unit variance."""
    with TemporaryDirectory() as work:
        for source in (*(folder / "Cell").glob("*.[ch]"), folder / "Grow" / "mt19937ar.c"):
            shutil.copy(source, work)
        source = Path(work) / "mdCell.c"
        numbers = {"maxtime": t_end, "writeinterval": t_end, "maxscheduletime": _BLOCK}
        numbers["eventlisttimemultiplier"] = _BLOCK
        source.write_text(_edited(source.read_text(), numbers))
        _write_grid(Path(work) / "init.sph", n, filling)
        subprocess.run(["gcc", *FLAGS, source.name, "-o", "md", "-lm"], cwd=work, check=True)
        before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        done = subprocess.run(["./md"], cwd=work, capture_output=True, text=True, check=True)
        used = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
    return used, int(re.findall(r"Collisions: (\d+)", done.stdout)[-1])


def cost(folder: Path, n: int, impacts: float, filling: float) -> float:
    """Time of a collision [µs], after four of each ball, without set-up."""
    density = 6.0 * filling / math.pi
    rate = 2.0 * math.sqrt(math.pi) * density * n
    first = _run(folder, 4.0 * n / rate, n, filling)
    second = _run(folder, (4.0 * n + impacts) / rate, n, filling)
    return 1e6 * (second[0] - first[0]) / (second[1] - first[1])
