"""Puts each bug of `faults.yaml` into a copy of the package and runs the tests that must catch it.

usage: python tests/faults/run.py [--jobs N] [--list] [ID ...]

Exit code 1 if a fault is missed, if its text is not in its file exactly once, or if its tests fail without it.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[2]
COPIED = ("kickbench", "tests")
LINKED = (
    "assets",
    "methods",
    "results",
    "tasks",
    "pyproject.toml",
    "README.md",
    "Makefile",
    "constraints.txt",
)
TIMEOUT = 600.0
"""Seconds for the tests of one fault."""
NO_FAULT = "no fault"
OUTCOMES = {0: "missed", 1: "caught"}
"""Of pytest's exit codes; another one means that the tests did not run: a wrong name, or an import that fails."""

Fault = dict[str, str]


def copy_of_repository(folder: Path) -> None:
    """Makes a copy that may be changed; what is only read is linked."""
    for name in COPIED:
        shutil.copytree(ROOT / name, folder / name)
    for name in LINKED:
        if (ROOT / name).exists():
            (folder / name).symlink_to(ROOT / name)


def run_tests(folder: Path, tests: list[str]) -> tuple[int | None, str]:
    """Exit code of pytest, None if it took too long, and the line that says which test failed."""
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-x",
        "-q",
        "--no-header",
        "-p",
        "no:cacheprovider",
        "-m",
        "not slow",
    ]
    command += tests
    environment = {**os.environ, "PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, text=True, timeout=TIMEOUT
        )
    except subprocess.TimeoutExpired:
        return None, f"more than {TIMEOUT:.0f} s"
    lines = (done.stdout + done.stderr).splitlines() or [""]
    failed = [line for line in lines if line.startswith(("FAILED", "ERROR"))]
    return done.returncode, (failed or lines)[-1][:150]


def try_fault(fault: Fault) -> tuple[str, str]:
    """Outcome and what pytest said."""
    with tempfile.TemporaryDirectory(prefix="kickbench-fault-") as name:
        folder = Path(name)
        copy_of_repository(folder)
        if fault["id"] != NO_FAULT:
            file = folder / fault["file"]
            text = file.read_text() if file.is_file() else ""
            if (count := text.count(fault["old"])) != 1:
                return "does not apply", f"{fault['file']} has the text {count} times"
            file.write_text(text.replace(fault["old"], fault["new"]))
        code, said = run_tests(folder, fault["tests"].split())
        return OUTCOMES.get(-1 if code is None else code, "tests did not run"), said


def chosen(ids: list[str]) -> list[Fault]:
    """The faults with these ids, or all."""
    faults: list[Fault] = yaml.safe_load((Path(__file__).parent / "faults.yaml").read_text())
    repeated = [name for name, count in Counter(fault["id"] for fault in faults).items() if count > 1]
    unknown = set(ids) - {fault["id"] for fault in faults}
    if repeated or unknown:
        raise SystemExit(f"ids that occur twice: {repeated}; that do not occur: {sorted(unknown)}")
    return [fault for fault in faults if not ids or fault["id"] in ids]


def main() -> int:
    """Tries the faults that are asked for, and prints the outcome of each."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("ids", nargs="*", metavar="ID", help="faults (default: all)")
    parser.add_argument("--jobs", type=int, default=1, help="faults tried at a time (default: 1)")
    parser.add_argument("--list", action="store_true", help="print the faults and try none")
    options = parser.parse_args()
    faults = chosen(options.ids)
    if options.list:
        print("\n".join(f"{fault['id']:<32} {fault['what']}" for fault in faults))
        return 0
    tests = " ".join(dict.fromkeys(test for fault in faults for test in fault["tests"].split()))
    outcome, said = try_fault({"id": NO_FAULT, "tests": tests})
    if outcome != "missed":
        print(f"the tests do not pass without a fault: {said}")
        return 1
    counts, started = Counter[str](), time.monotonic()
    with ThreadPoolExecutor(options.jobs) as pool:
        for fault, (outcome, said) in zip(faults, pool.map(try_fault, faults), strict=True):
            counts[outcome] += 1
            note = "" if outcome == "caught" else f": {fault['what']} ({said})"
            print(f"{outcome:<17} {fault['id']}{note}", flush=True)
    summary = ", ".join(f"{count} {outcome}" for outcome, count in counts.items())
    print(f"{len(faults)} faults: {summary}; {time.monotonic() - started:.0f} s")
    return int(counts["caught"] < len(faults))


if __name__ == "__main__":
    raise SystemExit(main())
