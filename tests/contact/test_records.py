"""Records: fields are views, and a checkpoint has them as rows of floats."""

import numpy as np
import pytest

from particlerb.contact.records import (
    CONTACT_FORCES,
    PISTON,
    ROLLING_FORCES,
    forces_record,
    from_floats,
    to_floats,
    zero_records,
)


def test_fields_are_views_of_the_rows_of_floats():
    pistons = zero_records(PISTON, 3)
    pistons.velocity[1] = 2.0
    rows = to_floats(pistons)
    assert rows.shape == (3, len(PISTON.names))
    assert rows[1].tolist() == [2.0 if name == "velocity" else 0.0 for name in PISTON.names]
    again = from_floats(rows, PISTON)
    again.displacement[0] = 5.0
    assert pistons.displacement[0] == 5.0
    with pytest.raises(AttributeError):
        _ = pistons.torque


def test_copies_and_parts_have_fields_of_their_own():
    pistons = zero_records(PISTON, 3)
    pistons.velocity[:] = 1.0, 2.0, 3.0
    copy, part = pistons.copy(), pistons[1:]
    copy.velocity[0] = 7.0
    assert pistons.velocity[0] == 1.0
    assert part.velocity.tolist() == [2.0, 3.0]


def test_vectors_of_records_without_rows():
    none = from_floats(np.zeros((0, 13)), CONTACT_FORCES)
    assert none.elastic.shape == (0, 3)


def test_wall_and_rolling_fields_come_behind_those_of_every_contact():
    n = len(CONTACT_FORCES.names)
    assert ROLLING_FORCES.names[:n] == forces_record(True, True).names[:n] == CONTACT_FORCES.names
    assert forces_record(False, False) == CONTACT_FORCES
    assert "rolling_torque" not in forces_record(False, True).names
