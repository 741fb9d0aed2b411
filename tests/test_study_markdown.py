"""Markdown of the study's pages."""

from study.markdown import to_html


def test_markdown():
    text = "# A & B\n\nOne *two* **three**\nfour <b>\n\n- x\n  more\n- [y](https://a.b/c?d=1&e=2)\n\n## End\nlast"
    assert to_html(text) == (
        "<h1>A &amp; B</h1>\n<p>One <em>two</em> <strong>three</strong> four &lt;b&gt;</p>\n"
        '<ul>\n<li>x more</li>\n<li><a href="https://a.b/c?d=1&amp;e=2" rel="noreferrer">y</a></li>\n</ul>\n'
        "<h2>End</h2>\n<p>last</p>"
    )
    assert "<script" not in to_html("<script>alert(1)</script>\n\n# <script>\n\n- <script>")
    assert to_html('[x](javascript:alert(1)) [x](https://a" onclick="b)').count("<a") == 0
    assert 'onclick="' not in to_html('[x](https://a" onclick="b) [y](https://a"onclick="b)')
    assert to_html("") == "" and to_html("2 * 3 * 4") == "<p>2 * 3 * 4</p>"
    assert to_html("words\n- item") == "<p>words</p>\n<ul>\n<li>item</li>\n</ul>"


def test_signs_that_never_end_take_no_time():
    for sign in ("[", "*", "**", "*a ", "[a", "[a](https://"):
        text = sign * (100_000 // len(sign))
        assert len(to_html(text)) > 10_000
