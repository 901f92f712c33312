"""Puts each bug of `faults.yaml` into a copy of the package and runs the tests that must catch it.

usage: python tests/faults/run.py [--jobs N] [--tested] [ID ...]

Every job has one copy of the repository. A fault is written into it, its tests run in a process that is forked off
with torch and MuJoCo imported already, and the file is written back.

Exit code 1 if a fault is missed, if its text is not in its file exactly once, or if its tests fail without it.
"""

from __future__ import annotations

import argparse
import compileall
import importlib
import multiprocessing
import os
import shutil
import signal
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from py_compile import PycInvalidationMode

import yaml

ROOT = Path(__file__).resolve().parents[2]
COPIED = ("kickbench", "tests")
IMPORTED = ("hypothesis", "mujoco", "pandas", "pydantic", "pytest", "rsl_rl.runners", "scipy.stats", "torch")
"""What takes long to import and is not of this repository."""
PYTEST = ["-x", "-q", "--no-header", "-p", "no:cacheprovider", "-m", "not slow"]
TIMEOUT = 600.0
"""Seconds for the tests of one fault; tests that take longer end with an error."""
OUTCOMES = {0: "missed", 1: "caught"}
"""Of pytest's exit codes; another one means that the tests did not run: a wrong name, or an import that fails."""
FORK = multiprocessing.get_context("fork")


def make_copy(parent: str) -> None:
    """Makes a copy of the repository that may be changed, and works in it; what is only read is linked."""
    folder = Path(tempfile.mkdtemp(dir=parent))
    for path in ROOT.glob("[!.]*"):
        if path.name in COPIED:
            shutil.copytree(path, folder / path.name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            (folder / path.name).symlink_to(path)
    # Compiled code that is used only where its source has not changed, whatever the clock says.
    compileall.compile_dir(folder / "kickbench", quiet=2, invalidation_mode=PycInvalidationMode.CHECKED_HASH)
    os.chdir(folder)
    os.environ |= {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    sys.dont_write_bytecode = True
    sys.path.insert(0, str(folder))


def _pytest(tests: list[str], log: str) -> None:
    """Runs tests, in a process and a process group of their own."""
    os.setsid()
    with open(log, "wb") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    import pytest

    code = pytest.main([*PYTEST, *tests])
    sys.stdout.flush()
    os._exit(int(code))


def run_tests(tests: str, timeout: float) -> tuple[str, str]:
    """Outcome, and the last line of pytest's output or the last one that names a failed test."""
    log = Path("output.txt")
    process = FORK.Process(target=_pytest, args=(tests.split(), str(log)))
    process.start()
    process.join(timeout)
    if process.exitcode is None:
        os.killpg(process.pid or 0, signal.SIGKILL)
        return "took too long", f"more than {timeout:.0f} s"
    lines = log.read_text(errors="replace").splitlines() or [""]
    failed = [line for line in lines if line.startswith(("FAILED", "ERROR"))]
    return OUTCOMES.get(process.exitcode, "tests did not run"), (failed or lines)[-1][:150]


def misfit(fault: dict[str, str], root: Path = ROOT) -> str | None:
    """What keeps a fault from being tried: its text is in its file never or more than once."""
    file = root / fault["file"]
    count = file.read_text().count(fault["old"]) if file.is_file() else 0
    return None if count == 1 else f"{fault['id']}: {fault['file']} has its text {count} times"


def try_fault(fault: dict[str, str]) -> tuple[str, str, float]:
    """Outcome, why, and seconds of CPU."""
    before = sum(os.times()[2:4])
    file = Path(fault["file"])
    text = file.read_text()
    file.write_text(text.replace(fault["old"], fault["new"]))
    try:
        outcome, why = run_tests(fault["tests"], TIMEOUT)
    finally:
        file.write_text(text)
    return outcome, why, sum(os.times()[2:4]) - before


def pass_without_faults(faults: list[dict[str, str]], pool: ProcessPoolExecutor) -> bool:
    """Whether the tests of all faults pass without one."""
    tests = " ".join(dict.fromkeys(test for fault in faults for test in fault["tests"].split()))
    print(f"{len(faults)} faults; first their tests without a fault", flush=True)
    outcome, why = pool.submit(run_tests, tests, TIMEOUT * len(faults)).result()
    print(why, flush=True)
    return outcome == "missed"


def try_all(faults: list[dict[str, str]], pool: ProcessPoolExecutor) -> int:
    """Tries faults, prints the outcome of each, and returns the exit code."""
    started = time.monotonic()
    wrong: list[str] = []
    for number, (fault, result) in enumerate(zip(faults, pool.map(try_fault, faults), strict=True), 1):
        outcome, why, seconds = result
        print(f"{number}/{len(faults)} {outcome} {fault['id']} ({seconds:.1f} s of CPU)", flush=True)
        if outcome != "caught":
            wrong.append(f"{outcome}: {fault['id']}: {fault['what']} ({why})")
    print(f"{len(faults) - len(wrong)} of {len(faults)} faults caught in {time.monotonic() - started:.0f} s")
    print("\n".join(wrong))
    return int(bool(wrong))


def read_faults() -> list[dict[str, str]]:
    """The faults in the order of their file."""
    return yaml.safe_load(Path(__file__).with_name("faults.yaml").read_text())


def main() -> int:
    """Tries the faults that are asked for."""
    cores = len(os.sched_getaffinity(0))
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("ids", nargs="*", metavar="ID", help="faults (default: all)")
    parser.add_argument("--jobs", type=int, default=cores, help=f"faults tried at a time (default: {cores})")
    parser.add_argument("--tested", action="store_true", help="the tests have just passed without a fault")
    options = parser.parse_args()
    faults = read_faults()
    if unknown := set(options.ids) - {fault["id"] for fault in faults}:
        parser.error(f"no such faults: {', '.join(sorted(unknown))}")
    faults = [fault for fault in faults if not options.ids or fault["id"] in options.ids]
    if misfits := [found for fault in faults if (found := misfit(fault))]:
        print("these faults cannot be tried:", *misfits, sep="\n")
        return 1
    os.environ["OMP_NUM_THREADS"] = "1"
    for module in IMPORTED:
        importlib.import_module(module)
    with (
        tempfile.TemporaryDirectory(prefix="kickbench-faults-") as parent,
        ProcessPoolExecutor(options.jobs, FORK, make_copy, (parent,)) as pool,
    ):
        if not options.tested and not pass_without_faults(faults, pool):
            return 1
        return try_all(faults, pool)


if __name__ == "__main__":
    raise SystemExit(main())
