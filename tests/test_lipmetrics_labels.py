import pytest

from lipmetrics.errors import InputError
from lipmetrics.labels import Labels, labels_of_name, normal, read_list


@pytest.mark.parametrize(
    ("path", "pattern", "expected"),
    [
        ("real/anna_mm_2.frames.csv", "{speaker}_{utterance}_{repeat}", Labels("mm", "anna", "2")),
        ("anna_slow_open_2.mp4", "{speaker}_{utterance}_{repeat}", Labels("slow_open", "anna", "2")),
        ("anna_mm", "{speaker}_{utterance}", Labels("mm", "anna")),
        ("clips/anna/mm-2.npy", "{speaker}/{utterance}-{repeat}", Labels("mm", "anna", "2")),
        ("take7 mm (b)", "{any} {utterance} ({repeat})", Labels("mm", None, "b")),
        ("bbaf2n.mpg", "{utterance}", Labels("bbaf2n")),
        ("v1.25_mm.csv", "{group}_{utterance}", Labels("mm", group="v1.25")),
    ],
)
def test_names(path, pattern, expected):
    assert labels_of_name(path, pattern) == expected


@pytest.mark.parametrize(
    ("path", "pattern", "sentence"),
    [
        ("anna.mp4", "{speaker}_{utterance}", "expected a name like '{speaker}_{utterance}', got 'anna'"),
        ("a_b_c", "{speaker}_{repeat}", "got 'a_b_c'"),
        ("a_b", "{speeker}_{utterance}", "did you mean {speaker}"),
        ("a_b", "{speaker}_{speaker}", "each once"),
        ("a_b", "{speaker}{utterance}", "something between"),
        ("a_b", "speaker", "each once"),
        ("a_b", "{speaker_{utterance}", "expected --names"),
    ],
)
def test_bad_names(path, pattern, sentence):
    with pytest.raises(InputError) as error:
        labels_of_name(path, pattern)
    assert sentence in str(error.value)


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return path


def test_a_list_is_relative_to_its_folder(tmp_path):
    table = write(
        tmp_path / "list.csv",
        "path,speaker,utterance,notes,group\nreal/a.csv,anna,mm,good,real\n../b.csv,,mm,,mine\n",
    )
    found = read_list(table)
    assert list(found) == [normal(tmp_path / "real/a.csv"), normal(tmp_path.parent / "b.csv")]
    assert list(found.values()) == [Labels("mm", "anna", None, "real"), Labels("mm", None, None, "mine")]


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "of which path is needed, got none"),
        ("file,speaker\na,b\n", "of which path is needed, got file, speaker"),
        ("path,speakr\na,b\n", "did you mean 'speaker'"),
        ("path,speaker\n,b\n", "found none in line 2"),
        ("path\na\n./a\n", "again in line 3"),
        ("path\n", "at least one take"),
    ],
)
def test_bad_lists(tmp_path, text, sentence):
    with pytest.raises(InputError, match=sentence):
        read_list(write(tmp_path / "list.csv", text))


def test_no_list(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_list(tmp_path / "none.csv")
    (tmp_path / "bytes.csv").write_bytes(b"\xff\xfe\x00path")
    with pytest.raises(InputError, match="CSV table"):
        read_list(tmp_path / "bytes.csv")


def test_a_path_that_no_file_can_have(tmp_path):
    (tmp_path / "list.csv").write_bytes(b"path,speaker\na\0b.mp4,p01\n")
    with pytest.raises(InputError, match="expected the path of a take in line 2"):
        read_list(tmp_path / "list.csv")
