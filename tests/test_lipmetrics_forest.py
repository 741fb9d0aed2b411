"""Files of forests that cannot be used."""

import numpy as np
import pytest

from lipmetrics.errors import InputError
from lipmetrics.forest import Forest, load_forest, save_forests


def test_damaged_files_are_one_sentence(tmp_path):
    questions = np.zeros((2, 3, 6), np.int32)
    forest = Forest(questions, np.zeros((2, 3), bool), np.zeros((2, 8, 1), np.float32), np.zeros(1, np.float32))
    path = tmp_path / "a.npz"
    save_forests(path, {"coarse": forest})
    assert load_forest(path, "coarse").questions.shape == (2, 3, 6)
    with pytest.raises(InputError, match="expected a file of forests with 'fine' in it"):
        load_forest(path, "fine")
    good = path.read_bytes()
    for data in (b"", b"x", good[: len(good) // 2], good.replace(b"PK", b"PX"), b"\x80\x04N."):
        path.write_bytes(data)
        with pytest.raises(InputError, match="expected a file of forests"):
            load_forest(path, "coarse")
