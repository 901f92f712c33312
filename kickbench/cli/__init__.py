"""The command line: parse, call, print. Verbs are imported when they are called, so `--help` is instant."""

from __future__ import annotations

import argparse
import io
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from kickbench import __version__
from kickbench.cli.faults import fault_message, mute, report_fault
from kickbench.cli.values import natural, port, positive, scale, size
from kickbench.errors import KickbenchError


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line.

    Args:
        argv: Arguments without the program's name; default: the process's.

    Returns:
        Exit code: 0 fine, 1 a check or the system failed, 2 a wrong specification or usage, 130 interrupted.
    """
    for stream in (sys.stdout, sys.stderr):
        # Names of files may hold bytes that are not UTF-8.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    arguments = _parser().parse_args(argv)
    module, _, name = arguments.verb.partition(":")
    try:
        code = getattr(import_module(module), name)(arguments)
        if sys.stdout is not None:
            sys.stdout.flush()  # while there is still someone to handle a full disk
        return code
    except KeyboardInterrupt:
        report_fault("interrupted")
        return 130
    except BrokenPipeError:
        # The reader of our output has gone (`kickbench show ... | head`): nobody is left to be told.
        mute(sys.stdout, sys.stderr)
        return 1
    except Exception as error:
        message = fault_message(error)
        if message is None:
            raise
        mute(sys.stdout)
        report_fault(message)
        return 2 if isinstance(error, KickbenchError) else 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="kickbench", description="A declarative benchmark suite for symmetry-aware humanoid RL."
    )
    parser.add_argument("--version", action="version", version=f"kickbench {__version__}")
    verbs = parser.add_subparsers(required=True, metavar="VERB")
    _add_run(verbs)
    _add_reproduce(verbs)
    _add_eval(verbs)
    _add_inspection(verbs)
    _add_bench(verbs)
    _add_view(verbs)
    _add_play(verbs)
    _add_symmetry(verbs)
    _add_audit(verbs)
    _add_verb(verbs, "doctor", "kickbench.cli.doctor:doctor", "say what can run here, and why not the rest")
    _add_report(verbs)
    return parser


def _add_verb(
    verbs: argparse._SubParsersAction, name: str, target: str, text: str
) -> argparse.ArgumentParser:
    verb = verbs.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
    verb.set_defaults(verb=target)
    return verb


def _add_run(verbs: argparse._SubParsersAction) -> None:
    verb = _add_verb(verbs, "run", "kickbench.cli.run:run", "train a method on a task and evaluate it")
    verb.add_argument("task", type=Path, metavar="TASK", help="task YAML")
    verb.add_argument("method", type=Path, metavar="METHOD", help="method YAML")
    verb.add_argument("--seed", type=natural, default=0, help="seed (default: 0)")
    verb.add_argument("--iterations", type=positive, help="iterations (default: the method's)")
    _add_scale(verb)
    verb.add_argument("--num-envs", type=positive, help="parallel environments (default: the method's)")
    verb.add_argument(
        "--out", type=Path, metavar="DIR", help="run directory (default: runs/<task>/<method>/seed<k>)"
    )
    _add_set(verb)
    _add_device(verb, "train")
    verb.add_argument(
        "--no-graph",
        action="store_false",
        dest="graph",
        help="run every kernel of a step on its own instead of one CUDA graph: slow, for finding faults",
    )
    _add_threads(verb)
    text = "experiment that the run is for: its claims are recorded"
    verb.add_argument("--experiment", type=Path, metavar="REPORTED", help=text)
    taken = verb.add_mutually_exclusive_group()
    taken.add_argument("--force", action="store_true", help="overwrite a run that is there")
    taken.add_argument(
        "--resume", action="store_true", help="go on with the run that is there; --iterations may extend it"
    )


def _add_reproduce(verbs: argparse._SubParsersAction) -> None:
    module = "kickbench.cli.reproduce"
    verb = _add_verb(
        verbs, "reproduce", f"{module}:reproduce", "run a whole experiment, or what is left of it"
    )
    verb.add_argument("reported", type=Path, metavar="REPORTED", help="experiment YAML (results/reported/)")
    verb.add_argument("--only", action="append", metavar="ARM", help="this arm only; may be repeated")
    verb.add_argument(
        "--seeds", type=natural, nargs="+", metavar="K", help="seeds (default: the experiment's)"
    )
    _add_scale(verb)
    _add_set(verb)
    verb.add_argument("--jobs", type=positive, default=1, help="runs at a time (default: 1)")
    _add_device(verb, "train")
    _add_threads(verb)
    verb.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder of the runs (default: runs/<experiment>; with --scale or --set one of its own)",
    )
    verb.add_argument("--dry-run", action="store_true", help="show the plan, write nothing")
    verb = _add_verb(verbs, "status", "kickbench.cli.status:status", "say how far the runs of a folder are")
    verb.add_argument("root", type=Path, metavar="DIR", help="folder of runs")


def _add_eval(verbs: argparse._SubParsersAction) -> None:
    verb = _add_verb(
        verbs, "eval", "kickbench.cli.run:evaluate", "evaluate the policy of a finished run again"
    )
    verb.add_argument("run", type=Path, metavar="RUN", help="run directory")
    verb.add_argument("--task", type=Path, metavar="TASK", help="another task (default: the run's)")
    verb.add_argument(
        "--save", action="store_true", help="keep the figures on another task in RUN/also/<task>.json"
    )
    verb.add_argument("--episodes", type=positive, help="episodes a side (default: the task's)")
    verb.add_argument("--seed", type=natural, help="seed of the starts (default: the task's)")
    verb.add_argument("--json", action="store_true", help="print the metrics as JSON")
    _add_threads(verb)


def _add_inspection(verbs: argparse._SubParsersAction) -> None:
    module = "kickbench.cli.inspect"
    verb = _add_verb(verbs, "validate", f"{module}:validate", "check YAML files and report all errors")
    verb.add_argument(
        "files",
        type=Path,
        nargs="+",
        metavar="FILE",
        help="task, method, robot, representations or reported",
    )
    _add_set(verb)
    verb = _add_verb(verbs, "show", f"{module}:show", "print a resolved spec and where each value came from")
    verb.add_argument(
        "file", type=Path, metavar="FILE", help="task, method, robot, representations or reported"
    )
    instead = verb.add_mutually_exclusive_group()
    instead.add_argument(
        "--plot",
        type=Path,
        metavar="FILE",
        action=_Plot,
        help="draw a task's sampling regions from above instead (.png, .svg)",
    )
    instead.add_argument(
        "--fields",
        type=Path,
        metavar="METHOD",
        action=_Fields,
        help="print how a task's observations and actions mirror, by a method's representations, instead",
    )
    _add_set(verb)
    verb = _add_verb(verbs, "schema", f"{module}:schema", "print the JSON Schema of a kind of file")
    verb.add_argument("kind", choices=("task", "method", "robot", "representations", "reported"))
    _add_verb(verbs, "terms", f"{module}:terms", "list all terms with parameters, units and source")
    verb = _add_verb(
        verbs,
        "list",
        f"{module}:list_files",
        "list tasks, methods, robots, experiments and runs below a folder",
    )
    verb.add_argument("root", type=Path, nargs="?", default=Path(), help="folder (default: here)")
    verb = _add_verb(verbs, "table", f"{module}:table", "print the table of finished runs")
    verb.add_argument(
        "roots", type=Path, nargs="+", metavar="DIR", help="run directories, or folders of them"
    )
    verb.add_argument("--columns", choices=("success", "kick"), default="success", help="figures to print")
    verb = _add_verb(
        verbs, "compare", f"{module}:compare", "compare methods over their seeds and on the same starts"
    )
    verb.add_argument(
        "roots", type=Path, nargs="+", metavar="DIR", help="run directories, or folders of them"
    )
    text = "judge the claims of an experiment by its measured runs"
    verb = _add_verb(verbs, "claims", "kickbench.cli.claims:claims", text)
    verb.add_argument(
        "experiment", type=Path, metavar="EXPERIMENT", help="experiment YAML (results/reported)"
    )
    verb.add_argument(
        "folder",
        type=Path,
        nargs="?",
        metavar="DIR",
        help="folder of its runs (default: measured/<experiment> beside the folder of the YAML file)",
    )
    verb.add_argument("--strict", action="store_true", help="exit code 1 unless every claim is met")
    verb.add_argument(
        "--power",
        action="store_true",
        help="simulate instead how often claims are met by an exact replication, and though they are wrong",
    )
    verb.add_argument("--json", action="store_true", help="print the verdicts as JSON (verdicts.json)")


def _add_bench(verbs: argparse._SubParsersAction) -> None:
    verb = _add_verb(verbs, "bench", "kickbench.cli.bench:bench", "measure speed, as ratios within one run")
    verb.add_argument("--task", type=Path, default=Path("tasks/mini_general.yaml"), help="task YAML")
    verb.add_argument(
        "--methods",
        type=Path,
        metavar="DIR",
        help="folder of the three methods compared (default: the first in methods that is for the task's robot)",
    )
    verb.add_argument("--num-envs", type=positive, nargs="+", metavar="N", help="worlds (default: 512)")
    verb.add_argument("--rounds", type=positive, default=10, help="interleaved repetitions (default: 10)")
    verb.add_argument("--json", type=Path, metavar="FILE", help="write the figures as JSON, too")
    verb.add_argument(
        "--profile", action="store_true", help="tell where the time goes, for the first number of worlds"
    )
    _add_set(verb)
    _add_device(verb, "measure")
    _add_threads(verb)


def _add_view(verbs: argparse._SubParsersAction) -> None:
    verb = _add_verb(verbs, "render", "kickbench.cli.view:render", "draw starts of a task, or film episodes")
    verb.add_argument("task", type=Path, metavar="TASK", help="task YAML")
    verb.add_argument("--policy", type=Path, metavar="RUN", help="run directory (default: zero action)")
    verb.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help=".png: a sheet of starts; .gif or .mp4: episodes (default: <task>.png)",
    )
    verb.add_argument("--starts", type=positive, metavar="N", help="starts on a sheet (default: 9)")
    verb.add_argument("--episodes", type=positive, metavar="N", help="episodes of a film (default: 3)")
    verb.add_argument("--seed", type=natural, help="seed of the starts (default: the task's)")
    verb.add_argument(
        "--size", type=size, metavar="WxH", help="pixels of a picture (default: 400x300, films 640x480)"
    )
    _add_set(verb)


def _add_play(verbs: argparse._SubParsersAction) -> None:
    text = "show a policy live in a browser, or a robot that stands on zero action"
    verb = _add_verb(verbs, "play", "kickbench.cli.view:play", text)
    verb.add_argument("path", type=Path, metavar="RUN|TASK", help="run directory, or task YAML (zero action)")
    verb.add_argument("--task", type=Path, metavar="TASK", help="another task for the run's policy")
    verb.add_argument("--seed", type=natural, help="seed of the initial states (default: the task's)")
    verb.add_argument(
        "--port", type=port, default=8080, help="port, or the next that is free (default: 8080)"
    )
    verb.add_argument(
        "--host",
        default="127.0.0.1",
        help="interface; with another than the default, everyone who reaches the port controls the page",
    )
    verb.add_argument(
        "--browser",
        action=argparse.BooleanOptionalAction,
        help="open a browser (default: where there is one)",
    )
    _add_set(verb)


def _add_symmetry(verbs: argparse._SubParsersAction) -> None:
    group = verbs.add_parser("symmetry", help="derive joint pairs and signs from a model's geometry")
    actions = group.add_subparsers(required=True, metavar="ACTION")
    text = "print the `symmetry:` block of a robot file, derived from the geometry of its MJCF"
    verb = _add_verb(actions, "derive", "kickbench.cli.symmetry:derive", text)
    verb.add_argument("model", type=Path, metavar="MODEL", help="MJCF file")
    verb.add_argument(
        "--plane",
        choices=("xz", "yz", "xy"),
        default="xz",
        help="mirror plane of the first body's frame (default: xz, which every task uses)",
    )


def _add_audit(verbs: argparse._SubParsersAction) -> None:
    text = "prove a task's symmetry tables against geometry and physics; exit code 1 if a row fails"
    verb = _add_verb(verbs, "audit", "kickbench.cli.audit:run", text)
    verb.add_argument("task", type=Path, metavar="TASK", help="task YAML")
    verb.add_argument(
        "method",
        type=Path,
        nargs="?",
        metavar="METHOD",
        help="method or representation table (default: the run's with --policy, else "
        "methods/representations/<robot's folder>.yaml beside or above the task)",
    )
    verb.add_argument("--policy", type=Path, metavar="RUN", help="run directory: measure its policy too")
    verb.add_argument("--states", type=positive, metavar="N", help="states to visit (default: 4096)")
    verb.add_argument("--seed", type=natural, default=0, help="seed of starts and actions (default: 0)")
    verb.add_argument("--json", action="store_true", help="print the report as JSON")
    _add_set(verb)
    _add_threads(verb)


def _add_report(verbs: argparse._SubParsersAction) -> None:
    text = "write one self-contained page about a folder of runs, or the README's results"
    verb = _add_verb(verbs, "report", "kickbench.cli.report:report", text)
    verb.add_argument(
        "folder", type=Path, nargs="?", metavar="DIR", help="a run directory, or a folder of them"
    )
    verb.add_argument(
        "-o", "--out", type=Path, metavar="FILE", help="page to write (default: DIR/report.html)"
    )
    verb.add_argument(
        "--experiment",
        type=Path,
        metavar="REPORTED",
        help="YAML of the experiment that DIR holds: puts what was reported beside it, and gives verdicts",
    )
    verb.add_argument(
        "--readme",
        action="store_true",
        help="write the results of README.md and results/pictures from results/measured instead",
    )
    verb.add_argument("--root", type=Path, default=Path(), help=argparse.SUPPRESS)


class _Plot(argparse.Action):
    """`show --plot` is another verb: it draws instead of printing."""

    def __call__(self, parser, namespace, values, option_string=None) -> None:
        namespace.plot, namespace.verb = values, "kickbench.cli.view:plot"


class _Fields(argparse.Action):
    """`show --fields` is another verb, too."""

    def __call__(self, parser, namespace, values, option_string=None) -> None:
        namespace.method, namespace.verb = values, "kickbench.cli.inspect:show_fields"


def _add_set(verb: argparse.ArgumentParser) -> None:
    verb.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="K=V",
        dest="overrides",
        help="override a value: key.path=value",
    )


def _add_scale(verb: argparse.ArgumentParser) -> None:
    verb.add_argument(
        "--scale",
        type=scale,
        metavar="S",
        help="shrink iterations and evaluation episodes (100 a side at least) by this factor, below 1; "
        "the result is marked",
    )


def _add_device(verb: argparse.ArgumentParser, what: str) -> None:
    verb.add_argument(
        "--device", choices=("cpu", "cuda"), default="cpu", help=f"where to {what} (default: cpu)"
    )


def _add_threads(verb: argparse.ArgumentParser) -> None:
    verb.add_argument("--threads", type=positive, help="threads (default: the cores this process may use)")
