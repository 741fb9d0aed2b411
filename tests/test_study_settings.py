"""study.toml and the pages' texts."""

import dataclasses

import pytest

from study.errors import InputError
from study.settings import TEXTS, Settings, load_page, load_settings, write_settings


def test_what_is_written_reads_as_the_defaults(tmp_path):
    written = write_settings(tmp_path, 7)
    assert [path.name for path in written] == ["study.toml", "consent.md", "instructions.md", "thanks.md"]
    assert load_settings(tmp_path) == Settings()
    text = (tmp_path / "study.toml").read_text()
    for field in dataclasses.fields(Settings):
        assert f"\n{field.name} = " in text or field.name == "texts"
    for name, words in TEXTS.items():  # each can be switched on by taking the # away
        (tmp_path / "study.toml").write_text(text.replace(f"# {name} = ", f"{name} = "))
        assert load_settings(tmp_path).texts[name] == words
    assert "about 7 minutes" in load_page(tmp_path, "consent")
    (tmp_path / "thanks.md").write_text("mine")
    assert write_settings(tmp_path, 7) == [] and load_page(tmp_path, "thanks") == "mine"


def test_settings(tmp_path):
    (tmp_path / "study.toml").write_text(
        'title = "Lips"\ntie_allowed = true\nabandoned_after_h = 2\nid_parameters = ["PROLIFIC_PID"]\n'
        '[texts]\nleft = "Links"\n'
    )
    settings = load_settings(tmp_path)
    assert (settings.title, settings.tie_allowed, settings.abandoned_after_h) == ("Lips", True, 2.0)
    assert settings.id_parameters == ("PROLIFIC_PID",)
    assert settings.texts["left"] == "Links" and settings.texts["right"] == "Right"


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("titel = 'a'", r"study\.toml: expected a setting, got 'titel'; did you mean 'title'\?"),
        ("title = 3", "expected title to be text in quotes, got 3"),
        ("tie_allowed = 'yes'", "expected tie_allowed to be true or false, got 'yes'"),
        ("abandoned_after_h = true", "expected abandoned_after_h to be a number"),
        ("abandoned_after_h = -1", "expected abandoned_after_h to be hours"),
        ("id_parameters = 'PROLIFIC_PID'", "expected id_parameters to be a list"),
        ("id_parameters = ['a b']", "expected id_parameters such as PROLIFIC_PID, got 'a b'"),
        ("sound = 'lefd'", r"left, both, off, got 'lefd'; did you mean 'left'\?"),
        ("completion_url = 'javascript:alert(1)'", "expected completion_url to begin with https://"),
        ("[texts]\nlefft = 'a'", r"expected a text under \[texts\], got 'lefft'; did you mean 'left'\?"),
        ("[texts]\nleft = 1", "expected left to be text in quotes, got 1"),
        ("texts = 1", r"expected texts to be a table, \[texts\]"),
        ("title =", "expected TOML, but"),
    ],
)
def test_bad_settings(tmp_path, line, said):
    (tmp_path / "study.toml").write_text(line)
    with pytest.raises(InputError, match=said):
        load_settings(tmp_path)


def test_missing_files(tmp_path):
    with pytest.raises(InputError, match=r"expected settings at .*'lipmetrics study design' makes them"):
        load_settings(tmp_path)
    with pytest.raises(InputError, match=r"expected the text of a page at .*consent\.md"):
        load_page(tmp_path, "consent")


@pytest.mark.parametrize("line", ["a." * 50_000 + "a = 1", "title = " + "[" * 20_000, "a = [\n" + "[" * 4000])
def test_settings_that_no_reader_of_toml_bears(tmp_path, line):
    (tmp_path / "study.toml").write_text(line + "\n")
    with pytest.raises(InputError, match="expected TOML"):
        load_settings(tmp_path)


def test_a_page_as_long_as_a_book(tmp_path):
    (tmp_path / "consent.md").write_text("a" * 300_000)
    with pytest.raises(InputError, match="a page of at most 200000 bytes"):
        load_page(tmp_path, "consent")
