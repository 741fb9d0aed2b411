"""What holds for all tests."""

import gc

import pytest


@pytest.fixture(scope="module", autouse=True)
def _nothing_old_is_searched_for_garbage():
    """Full collections pass over what lives on from the modules before: compiled code and imports, a million objects."""
    gc.collect()
    gc.freeze()
