"""Half of the turn of a slip: what the solve asks for, beside its formula in NumPy."""

import numpy as np
import pytest

from particlerb.compiled.barrier import ONE_THREAD
from particlerb.impulses import records as col
from particlerb.impulses.order import room_for_newton
from particlerb.impulses.records import TALLY, Impulses, room_for_partners, room_for_rows
from particlerb.impulses.rolling import ACROSS, DRIVEN
from particlerb.impulses.sliding import let_slide_on

M, MU, ROLLS = 200, 0.3, 0.02


def contacts():
    """Bodies that touch a wall each, in frames of any direction, half of them at the bound."""
    rng = np.random.default_rng(5)
    partners, rows = room_for_partners(M + 1), room_for_rows(M, with_rolling=True)
    rows.partner_a[:], rows.partner_b[:] = np.arange(M), M
    for k in range(M):
        axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        rows.frame[k, col.NORMAL : col.NORMAL + 3] = axes[0]
        rows.frame[k, col.TANGENT : col.TANGENT + 6] = axes[1:].ravel()
    rows.frame[:, col.FRICTION], rows.limits[:, col.SLOW], rows.limits[:, col.RADIUS] = MU, 0.1, 0.1
    rows.limits[:, col.LEAN : col.LEAN + 3], rows.rolling.limit[:, ACROSS] = 7.0, ROLLS
    share = rng.choice([0.3, 0.9], size=(2, M))  # of the bounds
    rows.impulse[:, 0], rows.impulse[:, 1] = 2.0, 2.0 * MU * share[0]
    rows.rolling.impulse[:, 2] = 2.0 * ROLLS * share[1]
    partners.before[:M, :6] = rng.normal(size=(M, 6))
    partners.velocity[:M] = partners.before[:M, :6] + 0.3 * rng.normal(size=(M, 6))
    partners.has_moved[:M] = rng.random(M) < 0.2
    none = np.zeros(0, dtype=np.int64)
    newton = room_for_newton(np.zeros(0, dtype=np.bool_), none, none, 0)
    return Impulses(None, partners, rows, np.array([M, -1]), np.zeros(TALLY), newton), share


def expected(impulses, share, first):
    """Minus half of what turns a slip, or ω, in tangents; NaN where it does not go on."""
    _, partners, rows, _, _, _ = impulses
    axes = rows.frame[:, col.TANGENT : col.TANGENT + 6].reshape(M, 2, 3)
    came, now = (
        np.einsum("kij,kj->ki", axes, v[:M, first : first + 3])
        for v in (partners.before, partners.velocity)
    )
    change, size = now - came, np.linalg.norm(came, axis=1)
    goes_on = (np.linalg.norm(change, axis=1) < 0.5 * size) & (share > 0.5)
    ahead = came / size[:, None]
    across = change - (change * ahead).sum(axis=1)[:, None] * ahead
    return np.where((goes_on & ~partners.has_moved[:M])[:, None], -0.5 * across, np.nan)


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_half_of_what_turns_a_slip_is_taken_back_by_any_number_of_threads(threads):
    impulses, share = contacts()
    for thread in range(threads):
        let_slide_on(impulses, ONE_THREAD._replace(size=threads, thread=thread))
    rows = impulses.rows
    slides = rows.limits[:, col.LEAN + 1 : col.LEAN + 3]
    rolls = rows.rolling.limit[:, DRIVEN + 1 : DRIVEN + 3]
    for found, first, left in ((slides, 0, 7.0), (rolls, 3, 0.0)):
        law = expected(impulses, share[first // 3], first)
        assert 20 < np.isfinite(law[:, 0]).sum() < M - 20
        assert found == pytest.approx(np.where(np.isnan(law), left, law), abs=1e-14)
    whole, _ = contacts()
    let_slide_on(whole, ONE_THREAD)
    assert (slides == whole.rows.limits[:, col.LEAN + 1 : col.LEAN + 3]).all()
    assert (rolls == whole.rows.rolling.limit[:, DRIVEN + 1 : DRIVEN + 3]).all()
