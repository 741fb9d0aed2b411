from lipmetrics.html_page import LONG_CELL, table


def test_numbers_stand_to_the_right_and_long_cells_are_broken_into_lines():
    long = "1.0 frames; " + "x" * LONG_CELL
    page = table([("name", "-0.3", long, "<b>")], ("what", "goal", "all", ""))
    assert page.count('<td class="n">') == 1 and '<td class="n">-0.3</td>' in page
    assert f'<td class="t">{long}</td>' in page
    assert "<td>name</td>" in page and "<td>&lt;b&gt;</td>" in page
