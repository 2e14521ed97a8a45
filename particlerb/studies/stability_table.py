"""The study of `stability` in words: limits beside theory, drift, maps; and its rows of numbers."""

import math
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from particlerb.studies import stability
from particlerb.studies.stability_limits import Limit
from particlerb.studies.stability_runs import LARGE, SMALL, VERDICTS
from particlerb.words import aligned

_LIMIT_HEAD: Final = ("method", "limit", "theory", "measured", "difference")
_DRIFT_HEAD: Final = ("method", "motion", "h|ω|", "energy error", "exponent", "|L| error")
_MAP_HEAD: Final = ("method", "map", "below 1e-3", "below 0.1", "10 % off after", "what happens")
_EXPLANATION: Final = """\
limit: steps from which on a linear motion grows, or factors of one step, beside closed forms
exponent: p of (largest energy error until t) ∝ t^p over the last decade of the turns, and
  its spread over 8 bodies; 0 bounded, 1/2 sum of rounding errors, 1 drift
map: shape, from needle to disc at a generic spin; start, from stable axes to the separatrix
below: largest h|ω| (dop853: tolerance) so that neither it nor any smaller one tried loses more
  energy; 10 % off: turns until then at the smallest one, of the first body"""


def table(study: stability.Stability) -> str:
    """Limits beside theory, drift, and for each map how far it is accurate and what comes then."""
    parts = []
    if study.limits:
        parts.append(aligned([_LIMIT_HEAD, *map(_limit_row, study.limits)]))
    if study.drifts:
        parts.append(aligned([_DRIFT_HEAD, *map(_drift_row, study.drifts)]))
    if study.maps:
        parts.append(aligned([_MAP_HEAD, *map(_map_row, study.maps)]))
    return "\n\n".join([*parts, _EXPLANATION])


def _limit_row(lim: Limit) -> tuple[str, ...]:
    """Texts of a limit."""
    return lim.method, lim.name, number(lim.theory), number(lim.measured), _percent(lim.difference)


def number(value: float) -> str:
    """Six digits; none where there is no limit, a dash where nothing is known."""
    return "none" if math.isinf(value) else "-" if math.isnan(value) else f"{value:.6g}"


def _percent(value: float) -> str:
    """Per cent of a difference."""
    return "-" if math.isnan(value) else f"{100.0 * value:.3f} %"


def _drift_row(drift: stability.EnergyDrift) -> tuple[str, ...]:
    """Texts of a drift."""
    p, spread = stability.growth_exponent(drift)
    size_and_growth = f"{drift.largest[-1]:.1e}", f"{p:.2f} ± {spread:.2f}"
    if math.isnan(p):
        ended = drift.turns[np.isinf(drift.largest).argmax()]
        size_and_growth = f"inf after {ended:.2g} turns", "-"
    is_told = drift.motion == stability.FREE and not math.isnan(p)
    spin = f"{drift.spin_error.max():.0e}" if is_told else "-"
    return drift.method, drift.motion, f"{drift.pace:g}", *size_and_growth, spin


def _map_row(map_: stability.Map) -> tuple[str, ...]:
    """Texts of a map."""
    if not map_.pace.any():
        worst = f"no step; worst error {map_.error.max():.0e}"
        return map_.method, map_.family, "any", "any", "-", worst
    first = map_.turns[0].min()
    steps = (f"{stability.largest_pace(map_, error):.2g}" for error in (SMALL, LARGE))
    lost = f"{first:.2g} turns" if math.isfinite(first) else "-"
    return map_.method, map_.family, *steps, lost, _what_happens(map_)


def _what_happens(map_: stability.Map) -> str:
    """Verdicts in the order in which they set in."""
    onsets = sorted(stability.onsets(map_).items(), key=lambda item: item[1])
    if not onsets:
        return f"accurate throughout; worst error {map_.error.max():.0e}"
    return "; ".join(f"{name} from {pace:.2g}" for name, pace in onsets)


_CSV_HEAD: Final = (
    "kind", "method", "name", "pace", "across", "energy_error", "verdict", "turns", "theory",
    "measured",
)  # fmt: skip


def csv_rows(study: stability.Stability) -> Iterator[Sequence[object]]:
    """Rows of numbers, the header first: maps, limits and drift, empty where a column has no sense.

    `pace` is h|ω| [rad] or the tolerance, `across` the side ratio or 2HI₂/L², `turns` those until
    the energy was off by 10 % (maps), or passed (drift).
    """
    yield _CSV_HEAD
    for map_ in study.maps:
        for (r, c), error in np.ndenumerate(map_.error):
            place = float(map_.pace[r]), float(map_.across[c])
            values = float(error), VERDICTS[map_.verdict[r, c]], float(map_.turns[r, c])
            yield "map", map_.method, map_.family, *place, *values, "", ""
    for limit in study.limits:
        yield "limit", limit.method, limit.name, *[""] * 5, limit.theory, limit.measured
    for drift in study.drifts:
        for turns, error in zip(drift.turns.tolist(), drift.error.max(axis=1), strict=True):
            row = drift.method, drift.motion, drift.pace, "", float(error), "", turns, "", ""
            yield "drift", *row
