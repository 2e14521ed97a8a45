"""Arrays of a run under the letters of formulas, for tests that write many of them."""

from types import SimpleNamespace

from particlerb.record.trajectory import Trajectory


def short_names(t: Trajectory) -> SimpleNamespace:
    """Times (T,), states (T, n, 3) and (T, n, 4), ledger, and constants."""
    return SimpleNamespace(
        t=t.time,
        x=t.position,
        q=t.orientation,
        v=t.velocity,
        w=t.angular_velocity,
        p=t.linear_momentum,
        L=t.angular_momentum,
        ledger=t.ledger,
        bodies=t.bodies,
    )
