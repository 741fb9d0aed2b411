"""The record of the saliva, whatever order its elements are in."""

import numpy as np
import pytest

from simulator.errors import InputError
from simulator.motion import SalivaRecord

NUMBERS = np.arange(6.0).reshape(2, 3)
RECORD = SalivaRecord(np.array([7, 2, 5]), NUMBERS.astype(np.uint8), NUMBERS, NUMBERS + 1, NUMBERS * 2)


def test_a_record_in_another_order():
    found = RECORD.of(np.array([2, 5, 7]))
    assert found.elements.tolist() == [2, 5, 7] and found.state.tolist() == [[1, 2, 0], [4, 5, 3]]
    for name in ("state", "stretch", "moisture", "critical"):
        np.testing.assert_array_equal(getattr(found.of(RECORD.elements), name), getattr(RECORD, name))


@pytest.mark.parametrize("elements", [[2, 5], [2, 5, 8], [2, 5, 7, 9]])
def test_a_record_of_other_elements(elements):
    with pytest.raises(InputError, match=f"record of the {len(elements)} elements of the mouth's saliva, got one of 3"):
        RECORD.of(np.array(elements))
