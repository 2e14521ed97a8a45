"""Where a force begins or stops, what contacts keep goes on: friction holds what it held."""

import numpy as np
import pytest

from particlerb.stepping import sparse_contact

CORNERS = [[x, y, 0.0] for x in (-0.1, 0.1) for y in (-0.1, 0.1)]
TILTED = {"acceleration": [2.0, 0.0, -9.0]}  # friction of 0.5 holds up to 4.5
EDGES = [[0.03, 0.05], [0.07, 0.08]]


def raft(make, edges):
    """Four spheres on a floor that is tilted, and pushes of nothing between the edges."""
    shape = {"type": "points", "position": CORNERS, "mass": 0.5, "radius": 0.05}
    body = {"name": "body", "shape": shape, "position": [0, 0, 0.05]}
    keys = {"contact": make.hooke(1e4, restitution=0.3), "wall": [make.plane()]}
    force = [make.push([1e-300, 0, 0], during=during) for during in edges]
    keys |= {"gravity": TILTED, "dt": 1e-3, "every": 0.02, "t_end": 0.1}
    return make.arrays(make.case(body, force=force, **keys))


@pytest.mark.parametrize("least", [1, 10**9])
def test_edges_of_a_force_do_not_let_a_raft_slip(make, monkeypatch, least):
    """With and without flights in between. The kick of a step in two halves changes rounding and
    the order of a slide, 1e-8 m; springs that were forgotten at each edge let it slip by 1e-3."""
    monkeypatch.setattr(sparse_contact, "LEAST_BODIES", least)
    held, cut = raft(make, []), raft(make, EDGES)
    assert np.abs(cut.position - held.position).max() < 1e-8
    assert np.abs(cut.ledger.energy_error).max() < 1e-6
    assert held.position[-1, 0, 0] > 1e-5  # it swings on its springs
