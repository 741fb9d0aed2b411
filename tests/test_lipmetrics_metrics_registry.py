import re

import pytest

from lipmetrics.errors import InputError
from lipmetrics.metrics import METRICS, NEEDS, metric


@pytest.mark.parametrize("row", METRICS.values(), ids=METRICS)
def test_every_row_is_whole(row):
    assert re.fullmatch(r"[a-z0-9_]+_v[1-9]", row.name)
    assert row.better in ("lower", "higher", "none")
    assert row.needs in NEEDS and callable(row.function)
    assert row.unit and row.formula and row.source


def test_a_name_that_is_nearly_right():
    assert metric("lve_meshtalk_v1") is METRICS["lve_meshtalk_v1"]
    with pytest.raises(InputError, match="got 'lve_meshtalk'; did you mean 'lve_meshtalk_v1'"):
        metric("lve_meshtalk")
    with pytest.raises(InputError, match=r"got 'xyz'$"):
        metric("xyz")
