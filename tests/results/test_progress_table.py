"""Reading progress.csv: figures by name, a cut row left out, a wrong file named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kickbench.errors import KickbenchError
from kickbench.results.progress_table import read_progress


def read(tmp_path: Path, text: str):
    (tmp_path / "progress.csv").write_text(text)
    return read_progress(tmp_path / "progress.csv")


def test_columns_come_by_name_and_empty_cells_are_nan(tmp_path):
    found = read(tmp_path, "iteration,a,b/c\n0,nan,\n1,2.5,3\n")
    assert found.iteration.tolist() == [0, 1]
    np.testing.assert_array_equal(found["a"], [np.nan, 2.5])
    np.testing.assert_array_equal(found["b/c"], [np.nan, 3.0])


def test_a_row_that_a_kill_cut_short_is_left_out(tmp_path):
    assert read(tmp_path, "iteration,a\n0,1\n1,2\n2,3.1").iteration.tolist() == [0, 1]


def test_a_table_without_rows_has_no_iterations(tmp_path):
    assert read(tmp_path, "iteration,a\n").empty
    assert read(tmp_path, "").columns.tolist() == ["iteration"], "before the first iteration has ended"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("step,a\n0,1\n", ":1: expected a progress table"),
        ("iteration,a\n0,1,2\n", "2 columns passed, passed data had 3"),
        ("iteration,a\n0,x\n", "could not convert"),
    ],
)
def test_a_wrong_table_is_an_error(tmp_path, text, message):
    with pytest.raises(KickbenchError, match=message):
        read(tmp_path, text)
