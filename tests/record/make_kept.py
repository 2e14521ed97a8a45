"""Makes the small file of this release that later versions must open: `test_kept.py` does.

    NUMBA_DISABLE_JIT=1 python tests/record/make_kept.py

It writes kept/schema_X.Y.h5.xz and beside it what `export` to CSV says of it. To be repeated before
a release, and whenever the schema has a new number; a file of an earlier schema stays as it is.
"""

import lzma
import tempfile
from pathlib import Path

import particlerb
from particlerb.export import export
from particlerb.record import schema

KEPT = Path(__file__).with_name("kept")
MOMENTS = {"type": "moments", "inertia": [1.0, 2.0, 2.5]}
CASE = {
    "title": "a file to keep",
    "run": {"t_end": 0.25, "every": 0.1, "dt": 0.0125, "threads": 1},
    "gravity": {"acceleration": [0.0, 0.0, -9.81]},
    "body": [
        {
            "name": "ball",
            "shape": {"type": "sphere", "radius": 0.1},
            "mass": 2.0,
            "count": 2,
            "place": {"type": "grid", "spacing": 0.19, "origin": [0, 0, 0.09]},
        },
        {
            "name": "top",
            "shape": MOMENTS,
            "contact": False,
            "mass": 2.0,
            "position": [0, 0, 3],
            "angular_velocity": [1.0, 0.4, -0.7],
        },
    ],
    "force": [{"type": "push", "body": "top", "force": [0, 1, 0], "at": [0.3, 0, 0]}],
    "contact": {"stiffness": 1e3, "restitution": 0.5, "friction": 0.5, "overlap": 0.5},
    "wall": [{"type": "plane", "name": "floor", "normal": [0, 0, 1]}],
    "output": {"fields": [*schema.FIELDS, *schema.CONTACT_FIELDS, *schema.WALLS, "contacts"]},
}


def main() -> None:
    """Write both."""
    schema.FEWEST_IN_CHUNK = 4  # small chunks: few bytes that mean nothing
    name = "schema_{}.{}".format(*schema.SCHEMA_VERSION)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "kept.h5"
        with particlerb.run(CASE, path) as trajectory:
            export(trajectory, KEPT / f"{name}.csv", "csv")
        (KEPT / f"{name}.h5.xz").write_bytes(lzma.compress(path.read_bytes(), preset=9))


if __name__ == "__main__":
    main()
