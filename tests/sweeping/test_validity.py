"""Until when values of a sweep hold: runs beside twins that are displaced as by rounding."""

import math
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest

import particlerb
from particlerb import CaseError
from particlerb.case.problems import path_of
from particlerb.case.reader import load
from particlerb.case.sweep import SweepTable
from particlerb.sweeping import validity
from particlerb.sweeping.table import SweepRows
from particlerb.sweeping.together import rows_together
from particlerb.sweeping.validity import valid_until
from particlerb.sweeping.variants import variants
from particlerb.sweeping.worker import Task, batch_of, work

POSITION = {"body": "body", "quantity": "position"}
CUE = {"body": "cue", "quantity": "position"}
SPEED = {"body": "body", "quantity": "angular_velocity"}


def run(t_end, every, dt=4e-3):
    """Steps of strang."""
    return {"t_end": t_end, "every": every, "method": "strang", "dt": dt}


def on_a_spring(t_end=120.0, dt=0.02):
    """A point that swings on a spring about as fast as it bounces, which is chaotic."""
    body = {"name": "body", "mass": 1.0, "shape": {"type": "moments", "inertia": [1.0, 1.0, 1.0]}}
    body["position"] = [1.1, 0.0, 1.0]
    spring = {"type": "spring", "body": "body", "anchor": [0.0, 0.0, 1.0], "stiffness": 25.0}
    spring["rest_length"] = 0.7
    down = {"gravity": {"acceleration": [0.0, 0.0, -9.81]}}
    return {"run": run(t_end, 0.5, dt), "body": [body], "force": [spring]} | down


def upright(t_end=6.0):
    """A pendulum that stands on its head, λ² = F l/I = 9 /s², unless it is a top that spins."""
    body = {"name": "body", "shape": {"type": "moments", "inertia": [2.0, 2.0, 1.0]}, "mass": 1.0}
    weight = {"type": "push", "body": "body", "at": [0.0, 0.0, 1.0], "force": [0.0, 0.0, -18.0]}
    return {"run": run(t_end, 0.02), "body": [body], "force": [weight]}


def spun(*rates):
    """Axis of tops by their rate about the vertical [rad/s]."""
    return {"body.0.angular_velocity": [[0.0, 0.0, rate] for rate in rates]}


def swept(scene, axes, asked=(POSITION,), share=0.01, **more):
    """Rows of a sweep that runs in this process."""
    table = {"axes": axes, "value": list(asked), "valid_within": share} | more
    with ThreadPoolExecutor(1) as executor:
        return particlerb.sweep(scene | {"sweep": table}, executor=executor)


@pytest.mark.plain
@pytest.mark.parametrize("rate", [0.0, 10.0])
def test_a_sleeping_top_holds_for_longer_by_the_rate_at_which_it_falls(rate, monkeypatch):
    """λ² = F l/I - (I' ω/2I)², I' about its axis; above 0 it falls.

    A hundredth of the displacement lasts longer by ln(100)/λ, to a frame at either end.
    """
    ends = []
    for displacement in (1e-12, 1e-14):
        monkeypatch.setattr(validity, "DISPLACEMENT", displacement)
        found = swept(upright(10.0), spun(rate), [SPEED])
        ends += found.column("valid_until")
    assert 1.0 < ends[0] < ends[1] < 10.0
    growth = math.sqrt(18.0 / 2.0 - (rate / 4.0) ** 2)
    assert ends[1] - ends[0] == pytest.approx(math.log(100.0) / growth, abs=0.04)


@pytest.mark.plain
def test_a_top_that_spins_fast_enough_to_stay_up_holds_to_the_end():
    tops = upright(10.0)
    asked = [SPEED, POSITION, {"body": "body", "quantity": "orientation"}]
    found = swept(tops, spun(14.0), asked)
    assert found.column("valid_until") == [10.0]


@pytest.mark.plain
def test_a_chaotic_motion_holds_for_longer_where_more_is_allowed(monkeypatch):
    """A regular one, of small swings, to the end; values are the same, asked or not."""
    axes = {"body.0.position": [[1.1, 0.0, 1.0], [0.9, 0.0, 1.0], [0.0, 0.0, 0.0]]}
    found = swept(on_a_spring(), axes)
    tight = swept(on_a_spring(), axes, share=1e-4)
    ends, early = found.column("valid_until"), tight.column("valid_until")
    assert ends[2] == early[2] == 120.0
    assert all(20.0 < a < b < 100.0 for a, b in zip(early[:2], ends[:2], strict=True))
    alone = swept(on_a_spring(), axes, share=None)
    assert [row[2:-1] for row in found.rows] == [row[2:] for row in alone.rows]
    assert alone.columns == found.columns[:-1]
    monkeypatch.setattr(validity, "DISPLACEMENT", 1e-14)
    later = swept(on_a_spring(), axes).column("valid_until")
    assert all(a < b for a, b in zip(ends[:2], later[:2], strict=True))


@pytest.mark.plain
def test_a_batch_with_twins_has_the_bits_of_rows_and_twins_alone():
    case, axes = upright(4.5), spun(0.0, 8.0, 14.0)
    table = SweepTable(axes=axes, value=[SPEED], valid_within=0.01)
    loaded = load(case)
    rows = tuple(one.values for one in variants(loaded, table))
    paths = tuple(map(path_of, axes))
    task = Task((0, 1, 2), rows, paths, loaded.source, table.value, True, 0, 0.01)
    together = rows_together(task.numbers, batch_of(task), task.asked, task.valid_within)
    assert repr(together) == repr(work(task._replace(is_batch=False)))
    ends = [row.values[-1] for row in together]
    assert ends[0] < ends[1] < ends[2] == 4.5
    alone = work(task._replace(is_batch=False, valid_within=None))
    assert [row.values[:-1] for row in together] == [row.values for row in alone]


@pytest.mark.plain
def test_hard_balls_part_after_some_impacts():
    found = swept(load("billiard_break").source.raw | {"check": {}}, {"run.seed": [1]}, [CUE])
    assert 1.5 < found.column("valid_until")[0] < 3.0


@pytest.mark.plain
def test_a_twin_is_stepped_as_the_run_is_whose_accuracy_is_asked_for():
    case = upright(0.5) | {"run": {"t_end": 0.5, "every": 0.1, "accuracy": 1e-3}}
    found = swept(case, {"body.0.angular_velocity": [[0.3, 0.2, 5.0]]}, [SPEED])
    assert found.column("status") == ["done"]
    assert found.column("valid_until") == [0.5]


def until(run, twin, share=0.01):
    """Until when a value holds while its body is far from where it is in the twin."""
    times = [0.0, 1.0, 2.0, 3.0]
    outcome = SimpleNamespace(probes=[SimpleNamespace(time=time) for time in times])
    pair = [np.array(x, dtype=float).reshape(4, 1, -1) for x in (run, twin)]
    poses = [(np.zeros((4, 1, n)), np.ones((4, 1, n))) for n in (3, 16)]
    return valid_until(outcome, [*poses, pair], share).tolist()


def test_values_part_where_they_differ_by_more_than_a_share_of_their_change():
    assert until([5, 6, 7, 8], [5, 6, 7, 8]) == [3.0]
    assert until([5, 6, 7, 8], [5, 6.009, 7.021, 8]) == [1.0]
    assert until([5, 6, 5, 5], [5, 6, 5.009, 5.011]) == [2.0]
    assert until([5, 6, 7, 8], [6, 6, 7, 8]) == [0.0]


def test_constants_do_not_part_by_rounding():
    assert until([5, 5, 5, 5], np.array([5, 5, 5, 5]) + 1e-12) == [3.0]


def test_means_tell_the_median_and_the_least():
    columns = ("run", "hash", "status", "energy_drift", "checks_missed", "run.seed", "valid_until")
    ends = [3.0, 1.0, 8.0, math.nan, 2.0, math.nan]
    rows = tuple(
        (k, str(k), "failed: it" if math.isnan(end) else "done", 0.0, 0, k, end)
        for k, end in enumerate(ends)
    )
    means = SweepRows(columns, rows, 1, 3).means()
    assert means.columns[-2:] == ("valid_until", "valid_until.least")
    assert means.column("valid_until") == [3.0, 2.0]
    assert means.column("valid_until.least") == [1.0, 2.0]


def test_rows_with_and_without_it_are_others():
    case = load(upright())
    tables = [SweepTable(axes=spun(1.0), value=[SPEED], valid_within=x) for x in (None, 0.1, 0.2)]
    assert len({variants(case, table)[0].hash for table in tables}) == 3


def test_it_needs_a_value():
    with pytest.raises(CaseError, match=r"whose validity is asked for"):
        swept(upright(), spun(1.0), [])
