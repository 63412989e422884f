"""Faults of the wire in each phase of a run: docs/reference/hils-faults.md states what follows."""

import pytest

from tests.helpers.fault_matrix import WIRE_FAULTS, require_row


@pytest.mark.parametrize("name", WIRE_FAULTS)
def test_fault_in_each_phase_has_its_stated_outcome(name):
    require_row(name)
