"""What a run leaves in a checkpoint that began anew on its way, and the run that goes on from it.

That is the tables that have changed, the files that only these name, when, and the states of then:
those by which it was planned, and those from which bodies moved on. All else follows from them, and
from the case of the file.
"""

import json
from base64 import b64decode, b64encode
from collections.abc import Mapping
from typing import Any

import numpy as np

from particlerb.case.reader import build
from particlerb.case.to_system import to_case, with_records
from particlerb.model.state import State, state_of
from particlerb.model.system import System
from particlerb.plan.continued import continued_from, saved_continued
from particlerb.plan.make_plan import make_plan
from particlerb.plan.segments import Plan
from particlerb.stepping.saved_arrays import Saved, under, within

_ENDS = ("t_end", "threads")  # of the run that goes on


def saved_restart(
    begun: System, system: System, time: float, planned: State, state: State
) -> Saved:
    """What to keep of a restart at a time [s] as another system than that which was begun with."""
    now, before = system.source.raw, begun.source.raw
    changed = {key for key in now if now[key] is not before.get(key)}
    text = to_case(system).model_dump_json(include=changed)
    known, files = begun.source.files.contents, system.source.files.contents
    more = {name: b64encode(files[name]).decode() for name in files if name not in known}
    saved = {
        "time": np.array(time),
        "tables": np.frombuffer(text.encode(), dtype=np.uint8),
        "files": np.frombuffer(json.dumps(more).encode(), dtype=np.uint8),
        "planned": np.vstack(planned),
        "state": np.vstack(state),
    }
    return saved | under("continued", saved_continued(system.continued))


def restart_from(begun: System, saved: Mapping[str, Any]) -> tuple[System, Plan, State]:
    """The system of a restart, its plan, and the state of then, which is not merged."""
    changed = json.loads(saved["tables"].tobytes())
    for name in _ENDS if "run" in changed else ():
        changed["run"][name] = getattr(begun.run, name)
    files = begun.source.files.copied(begun.source.files.allows_code)
    more = json.loads(saved["files"].tobytes())
    files.contents.update({name: b64decode(data) for name, data in more.items()})
    source = begun.source._replace(raw={**begun.source.raw, **changed}, files=files)
    system = with_records(begun, build(source, ()))
    continued = continued_from(begun, within("continued", saved))
    system = system._replace(continued=continued)
    plan = make_plan(system, now=(float(saved["time"]), state_of(saved["planned"])))
    return system, plan, state_of(saved["state"])
