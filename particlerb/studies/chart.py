"""A chart of what accuracy costs: all methods, and other engines, on one scene."""

import time
from collections.abc import Sequence

from particlerb.compiled.threads import THREADS
from particlerb.model.system import System
from particlerb.studies.peers import engines, variants_of
from particlerb.studies.points import BESIDE_CONVERGED, BY_ENERGY, BY_POSE, WorkPrecision
from particlerb.studies.text import chosen_names, method_names
from particlerb.studies.work_precision import Progress, Study


def chart(
    system: System,
    methods: Sequence[str] = (),
    peers: Sequence[str] = (),
    target: float | None = None,
    budget: float = 30.0,
    progress: Progress = lambda n: None,
    by_processor: bool = False,
    kind: type[Study] | None = None,
) -> WorkPrecision:
    """Measure the methods, and peers, on a system.

    Parameters
    ----------
    system : System
        Its own method, step and accuracy do not matter.
    methods, peers : sequence of str
        Names; no methods: all. Peers are other engines, see `studies.peers`.
    target : float, optional
        Error for which the cheapest method is sought [rad]; left out: 1e-6, and where bodies touch
        the energy_drift that the case allows, if it has one.
    budget : float
        Time to be spent on measuring, without compilation, about [s].
    progress : callable
        Called with 1 after each curve; there are `curve_count` of them.
    by_processor : bool
        Whether time is that of the processor, which other work on the machine does not prolong.
    kind : type, optional
        `contact_laws.LawStudy` for contact by impulses.

    Raises
    ------
    CaseError
        If it cannot be run.
    ValueError
        If there is no such method or peer.
    """
    names, rivals = chosen_names(methods, method_names(system), "method"), engines(peers)
    with THREADS.using(1, time.thread_time if by_processor else time.perf_counter):
        study = (kind or Study)(system, budget, bool(rivals))
        points, left_out = study.points(names, rivals, budget, progress)
    source = system.source.path
    return WorkPrecision(
        system.title or (source.stem if source else "scene"),
        system.n_bodies,
        study.sampled.size,
        system.run.t_end,
        points,
        study.reference.what,
        study.reference.floor,
        left_out,
        tuple((one.name, one.error) for one in system.chart.published),
        target or study.usual_target(),
        (BESIDE_CONVERGED if rivals else BY_ENERGY) if study.by_energy else BY_POSE,
        "time of the processor" if by_processor else "time",
        tuple(f"{one.NAME}: {study.words_of(one)}" for one in rivals if study.words_of(one)),
    )


def curve_count(system: System, methods: Sequence[str], peers: Sequence[str]) -> int:
    """Curves that a chart will have, for a progress bar."""
    n_methods = len(methods or method_names(system))
    return n_methods + sum(len(variants_of(engine, system)) for engine in engines(peers))
