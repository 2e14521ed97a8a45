"""One meaning per column: every spring is in potential_energy, what is lost in dashpots in work."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from particlerb.forces.kinds import VELOCITY
from particlerb.integrators import METHODS, UNJOINTED

START = {"position": [1.0, 0.2, 0.3], "velocity": [0.3, 0.1, -0.2], "orientation": [0.8, 0, 0.6, 0]}
AWAY = {"position": [2.5, 0.1, 0.4], "orientation": [0.6, 0, 0, 0.8]}
ANCHORED = ("one", [0.4, -0.1, 2.0], [0.1, 0.2, 0.3])  # body, anchor, at
SECOND = ("one", [-0.5, 1.0, 0.0], [0.0, -0.2, 0.1])
TIED = ("one", "two", [0.1, 0.2, 0.3], [0.2, 0.0, -0.1])  # bodies, at, to_at


def anchored(make, numbers, **keys):
    body, anchor, at = numbers
    return make.spring(anchor, 3.0, 0.6, at, body, **keys)


def tied(make, **keys):
    one, two, at, to_at = TIED
    return make.tie(two, 2.0, one, at=at, to_at=to_at, rest_length=0.9, **keys)


SCENES = {
    "undamped": lambda make: [anchored(make, ANCHORED), anchored(make, SECOND)],
    "damped": lambda make: [anchored(make, one, damping=0.4) for one in (ANCHORED, SECOND)],
    "mixed": lambda make: [anchored(make, ANCHORED), anchored(make, SECOND, damping=0.4)],
    "tied": lambda make: [anchored(make, ANCHORED), tied(make)],
    "tied, with a dashpot": lambda make: [anchored(make, ANCHORED), tied(make, damping=0.4)],
    "for a while": lambda make: [anchored(make, ANCHORED), anchored(make, SECOND, during=[0, 0.1])],
}
CODE = """
import json
import particlerb
for case in json.loads(CASES):
    with particlerb.run(case) as t:
        L = t.ledger
        print(json.dumps([t.time.tolist(), t.position.tolist(), t.orientation.tolist(),
            L.potential_energy.tolist(), L.work.tolist(), L.kinetic_energy.tolist(),
            L.energy_error.tolist(), L.energy.tolist()]))
"""
NAMES = ("time", "position", "orientation", "potential", "work", "kinetic", "error", "energy")


@pytest.fixture(scope="module")
def runs(make):
    """Of all methods on all scenes that they take; a few steps each, not worth a compiler."""
    keys = {"t_end": 0.2, "every": 0.02, "dt": 0.02, "tolerance": 1e-10}
    bodies = make.body("one", **START), make.body("two", **AWAY)
    names, cases = [], []
    for scene, force in SCENES.items():
        for method, record in ((name, METHODS[name]) for name in UNJOINTED):
            damped = any("damping" in one for one in force(make))
            if method == "exact" or (damped and VELOCITY not in record.accepts):
                continue
            names.append((scene, method))
            cases.append(make.case(*bodies, force=force(make), method=method, **keys))
    lines = make.python(f"CASES = {json.dumps(cases)!r}\n{CODE}", NUMBA_DISABLE_JIT="1")
    found = {}
    for name, line in zip(names, lines.splitlines(), strict=True):
        values = map(np.array, json.loads(line))
        found[name] = SimpleNamespace(**dict(zip(NAMES, values, strict=True)))
    return found


def stretched(make, run, force):
    """k (l - l₀)²/2 of a spring in each frame, by hand."""
    ends = [run.position[:, 0] + make.rotation(run.orientation[:, 0]).apply(force["at"])]
    if "to" in force:
        turned = make.rotation(run.orientation[:, 1]).apply(force["to_at"])
        ends.append(run.position[:, 1] + turned)
    else:
        ends.append(np.array(force["anchor"]))
    stretch = np.linalg.norm(ends[0] - ends[1], axis=1) - force["rest_length"]
    acts = run.time < force.get("during", [0, np.inf])[1]
    return np.where(acts, 0.5 * force["stiffness"] * stretch**2, 0.0)


@pytest.mark.parametrize("scene", SCENES)
def test_the_energy_of_all_springs_is_potential_and_what_dashpots_take_is_work(make, runs, scene):
    force = SCENES[scene](make)
    own = {method: run for (name, method), run in runs.items() if name == scene}
    assert set(own) >= {"strang", "dop853", "rk4", "semi_implicit_euler", "explicit_euler"}
    for run in own.values():
        by_hand = sum(stretched(make, run, one) for one in force)
        assert run.potential == pytest.approx(by_hand, abs=1e-13)
        assert np.ptp(by_hand) > 0.05
        if any("damping" in one for one in force):
            assert (np.diff(run.work) < 0).all()
        elif scene == "for a while":  # who takes a stretched spring away takes its energy
            gone = run.time >= 0.1
            assert not run.work[~gone].any()
            assert np.ptp(run.work[gone]) == 0.0
            assert run.work[-1] < -0.01
        else:
            assert not run.work.any()


def test_the_error_of_energy_does_not_depend_on_the_column(runs):
    for (_, method), run in runs.items():
        total = run.kinetic + run.potential
        assert run.energy == pytest.approx(total, abs=1e-14)
        assert run.error == pytest.approx(total - total[0] - run.work, abs=1e-13)
        # 0.2 s with steps of 0.02 s at rates of 2 /s, of energies of some J
        limit = {1: 0.1, 2: 2e-3}.get(METHODS[method].order, 1e-6)
        assert np.abs(run.error).max() < limit
