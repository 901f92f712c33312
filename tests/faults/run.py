"""Puts each bug of `faults.yaml` into a copy of the package and runs the tests that must catch it.

usage: python tests/faults/run.py [--jobs N] [ID ...]

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
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[2]
COPIED = ("kickbench", "tests")
PYTEST = ["-m", "pytest", "-x", "-q", "--no-header", "-p", "no:cacheprovider", "-m", "not slow"]
TIMEOUT = 1800.0
"""Seconds for one run of tests; one that takes longer ends with an error."""
OUTCOMES = {0: "missed", 1: "caught"}
"""Of pytest's exit codes; another one means that the tests did not run: a wrong name, or an import that fails."""


def make_copy(folder: Path) -> None:
    """Makes a copy of the repository that may be changed; what is only read is linked."""
    for path in ROOT.glob("[!.]*"):
        if path.name in COPIED:
            shutil.copytree(path, folder / path.name)
        else:
            (folder / path.name).symlink_to(path)


def run_tests(folder: Path, tests: str) -> tuple[str, str]:
    """Outcome, and the last line of pytest's output or the last one that names a failed test."""
    command = [sys.executable, *PYTEST, *tests.split()]
    environment = {**os.environ, "PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=TIMEOUT
    )
    lines = (done.stdout + done.stderr).splitlines() or [""]
    failed = [line for line in lines if line.startswith(("FAILED", "ERROR"))]
    return OUTCOMES.get(done.returncode, "tests did not run"), (failed or lines)[-1][:150]


def try_fault(fault: dict[str, str]) -> tuple[str, str, float]:
    """Outcome, why, and seconds. A fault whose `old` and `new` are equal changes nothing."""
    started = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="kickbench-fault-") as name:
        make_copy(Path(name))
        file = Path(name, fault["file"])
        text = file.read_text() if file.is_file() else ""
        if (count := text.count(fault["old"])) != 1:
            return "does not apply", f"{fault['file']} has the text {count} times", 0.0
        file.write_text(text.replace(fault["old"], fault["new"]))
        outcome, why = run_tests(Path(name), fault["tests"])
    return outcome, why, time.monotonic() - started


def main() -> int:
    """Tries the faults that are asked for, and prints the outcome of each."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("ids", nargs="*", metavar="ID", help="faults (default: all)")
    parser.add_argument("--jobs", type=int, default=1, help="faults tried at a time (default: 1)")
    options = parser.parse_args()
    faults = yaml.safe_load(Path(__file__).with_name("faults.yaml").read_text())
    if unknown := set(options.ids) - {fault["id"] for fault in faults}:
        parser.error(f"no such faults: {', '.join(sorted(unknown))}")
    faults = [fault for fault in faults if not options.ids or fault["id"] in options.ids]
    tests = " ".join(dict.fromkeys(test for fault in faults for test in fault["tests"].split()))
    print(f"{len(faults)} faults; first their tests without a fault", flush=True)
    outcome, why, _ = try_fault({**faults[0], "new": faults[0]["old"], "tests": tests})
    print(why, flush=True)
    if outcome != "missed":
        return 1
    caught = 0
    with ThreadPoolExecutor(options.jobs) as pool:
        for number, (fault, result) in enumerate(zip(faults, pool.map(try_fault, faults), strict=True), 1):
            outcome, why, seconds = result
            caught += outcome == "caught"
            note = "" if outcome == "caught" else f": {fault['what']} ({why})"
            print(f"{number}/{len(faults)} {outcome} {fault['id']} ({seconds:.0f} s){note}", flush=True)
    print(f"{caught} of {len(faults)} faults caught")
    return int(caught < len(faults))


if __name__ == "__main__":
    raise SystemExit(main())
