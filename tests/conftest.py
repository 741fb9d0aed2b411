"""What holds for all tests."""

import gc

import pytest


@pytest.fixture(scope="module", autouse=True)
def _nothing_old_is_searched_for_garbage():
    """Full collections pass over what earlier modules left behind, compiled code above all: a million objects."""
    gc.collect()
    gc.freeze()
