"""A message is one line of bounded length, whatever stood in the file that it tells of."""

import pytest

import lipmetrics.errors
import simulator.errors
import study.errors


@pytest.mark.parametrize("module", [lipmetrics.errors, simulator.errors, study.errors])
def test_messages_are_one_line_and_short(module):
    assert str(module.InputError("expected a, got b")) == "expected a, got b"
    text = str(module.InputError("expected a line, got\n" + "x" * 10**6 + "\ny; correct it"))
    assert "\n" not in text and len(text) <= module.LONGEST_MESSAGE
    assert text.startswith("expected a line, got xx") and text.endswith("xx y; correct it")
