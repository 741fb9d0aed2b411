import re
from pathlib import Path

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


DOC = (Path(__file__).parents[1] / "docs" / "metrics.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("row", METRICS.values(), ids=METRICS)
def test_the_page_has_a_row_of_every_metric(row):
    found = re.findall(rf"^\| `{row.name}` \| ([^|]+) \| ([^|]+) \| (.+) \|$", DOC, re.MULTILINE)
    assert len(found) == 1, f"expected one row of {row.name} in docs/metrics.md, found {len(found)}"
    unit, better, _ = found[0]
    assert unit == row.unit
    assert better == {"none": "-"}.get(row.better, row.better)


def test_the_page_has_no_metric_that_there_is_not():
    named = set(re.findall(r"`([a-z0-9_]+_v[1-9])`", DOC))
    assert named == set(METRICS)


@pytest.mark.parametrize("row", METRICS.values(), ids=METRICS)
def test_every_metric_is_a_function_of_its_module(row):
    function = getattr(row.function, "func", row.function)
    assert function.__module__ == f"lipmetrics.metrics.{row.family}"
    assert row.name.startswith(function.__name__.removesuffix("_v1"))
    assert function.__doc__
