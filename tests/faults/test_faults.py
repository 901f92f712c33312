"""Seeded faults that can be tried: `make faults` tries them."""

from __future__ import annotations

from .run import ROOT, misfit, read_faults


def test_every_fault_fits_the_code_and_names_tests_that_exist():
    faults = read_faults()
    assert not [found for fault in faults if (found := misfit(fault))]
    for fault in faults:
        for test in fault["tests"].split():
            file, *names = test.split("::")
            text = (ROOT / file).read_text()
            assert all(f"def {name}(" in text for name in names), f"{fault['id']}: {test}"


def test_no_two_faults_have_one_id():
    ids = [fault["id"] for fault in read_faults()]
    assert len(set(ids)) == len(ids)


def test_a_fault_whose_text_is_gone_or_there_twice_is_named(tmp_path):
    fault = {"id": "a-fault", "file": "code.py", "old": "x = 1"}
    assert misfit(fault, tmp_path) == "a-fault: code.py has its text 0 times"
    (tmp_path / "code.py").write_text("x = 1")
    assert misfit(fault, tmp_path) is None
    (tmp_path / "code.py").write_text("x = 1 # not x = 1")
    assert misfit(fault, tmp_path) == "a-fault: code.py has its text 2 times"
