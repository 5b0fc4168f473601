"""The command ``eladapt``: what an engineer asks first, without writing a script.

Every error is one line on stderr that starts with ``error:``, and an exit code other than 0: 1 for what is
wrong with a robot, a file or a run, 2 for what is wrong with the command itself. A run that a fault of the
torque gate ended is no error: it is written and summed up, and exits with 3. With --json what was found goes
to stdout, for programs; with --quiet nothing does.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.metadata
import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn

from eladapt.cli.saying import Outcome, as_json, say, say_table, warn
from eladapt.errors import EladaptError, UrdfError, did_you_mean

EXAMPLES = """examples:
  eladapt robots
  eladapt check my_arm.urdf --package-dir my_ws/src --lock "finger_*"
  eladapt run panda --goal 0.7 -0.1 0.4 -1.7 0.5 2.1 1.4 --payload 2 --plant mujoco --view
  eladapt report out/panda.npz
  eladapt identify panda log.csv --out identified.urdf --report identified.html
  eladapt stress panda --worlds 1000 --out stress_panda
  eladapt doctor
"""


class _Parser(argparse.ArgumentParser):
    """Says in one line what is wrong with a command."""

    def error(self, message: str) -> NoReturn:
        say(f"error: {message} (see: {self.prog} --help)", file=sys.stderr)
        sys.exit(2)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            legal = list(map(str, action.choices))
            said = f"invalid choice: {value!r}{did_you_mean([value], legal)} (choose from {', '.join(legal)})"
            raise argparse.ArgumentError(action, said)

    def unrecognized(self, arguments: Sequence[str]) -> NoReturn:
        """Says which options there are that may be meant."""
        legal = [option for action in self._actions for option in action.option_strings]
        meant = did_you_mean([given.partition("=")[0] for given in arguments if given[:1] == "-"], legal)
        self.error(f"unrecognized arguments: {' '.join(arguments)}{meant}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; the exit code is returned, or raised as SystemExit by --help and by the parser."""
    options, rest = _parser().parse_known_args(arguments)
    if rest:
        options.parser.unrecognized(rest)
    options.quiet |= options.json
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _warn
            with _muted(options.quiet):
                outcome = options.command(options)
        outcome = outcome if isinstance(outcome, Outcome) else Outcome(None, outcome or 0)
        if options.json:
            say_table(as_json(outcome.found))
        return outcome.code
    except KeyboardInterrupt:
        say("error: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # as by `eladapt robots | head -1`
        sys.stderr.close()
        return 1
    except OSError as reason:
        where = f"{reason.filename}: " if reason.filename else ""
        return _fail(f"{where}{reason.strerror or reason}")
    except UrdfError as reason:
        finding = reason.findings[0]
        what = f"{finding.problem}. {finding.remedy}" if finding.value == str(reason.path) else str(finding)
        return _fail(f"{reason.path}: {what}")
    except EladaptError as reason:
        return _fail(str(reason))


def _fail(message: str) -> int:
    say(f"error: {' '.join(message.split())}", file=sys.stderr)
    return 1


def _warn(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
    if issubclass(category, UserWarning):  # what a library is to leave behind some day is not the user's
        warn(message)


@contextlib.contextmanager
def _muted(quiet: bool) -> Iterator[None]:
    """Nothing goes to stdout meanwhile, if so wanted."""
    if not quiet:
        yield
        return
    with open(os.devnull, "w", encoding="utf-8") as nothing, contextlib.redirect_stdout(nothing):
        yield


def _parser() -> _Parser:
    from eladapt.cli import checking, completing, doctor, identifying, running, stressing

    parser = _Parser(
        prog="eladapt", epilog=EXAMPLES, formatter_class=argparse.RawDescriptionHelpFormatter,
        description="Composite adaptive finite-time control for any robot arm with a URDF.",
    )  # fmt: skip
    version = importlib.metadata.version("eladapt")
    parser.add_argument("--version", action="version", version=f"eladapt {version}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND", parser_class=_Parser)

    def command(name: str, function: Any, text: str, example: str) -> argparse.ArgumentParser:
        added = commands.add_parser(
            name, help=text, description=f"{text[0].upper()}{text[1:]}.", epilog=f"example:\n  {example}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )  # fmt: skip
        added.set_defaults(command=function, parser=added)
        added.add_argument("--json", action="store_true", help="print what was found as JSON, for a program; "
                           "null is what is infinite, unknown or never")  # fmt: skip
        added.add_argument("--quiet", action="store_true", help="print warnings and errors alone")
        return added

    command("robots", checking.robots, "list the robots that come with eladapt", "eladapt robots")

    check = command(
        "check", checking.check, "say what a URDF lacks, its ranks and limits, and whether gains exist",
        'eladapt check my_arm.urdf --package-dir my_ws/src --lock "finger_*" --dt 0.002',
    )  # fmt: skip
    _robot(check)
    check.add_argument(
        "--dt", type=float, default=1e-3, metavar="S", help="step of the controller (default: 0.001)"
    )

    run = command(
        "run", running.run, "move an arm in simulation, and keep what happened",
        "eladapt run panda --goal 0.7 -0.1 0.4 -1.7 0.5 2.1 1.4 --payload 2 --plant mujoco --view\n\n"
        "exit code: 0, or 3 when a fault of the torque gate ended the run (it is kept all the same), 1 or 2\n"
        "when something is wrong with the robot, the run or the command.",
    )  # fmt: skip
    _robot(run)
    run.add_argument("--goal", type=_numbers, nargs="+", metavar="X",
                     help="joint angles [rad] (or positions [m]), one a joint; --goal=0.1,-1e-3 works too "
                     "(default: the robot's own goal, or 0.5 from home)")  # fmt: skip
    run.add_argument(
        "--start", type=_numbers, nargs="+", metavar="X", help="the same, to start from (default: home)"
    )
    run.add_argument(
        "--payload", type=float, metavar="KG", help="a load at the tool, of which nobody tells the controller"
    )
    run.add_argument(
        "--attach", type=float, metavar="S", help="when the load of --payload is attached (default: 0)"
    )
    run.add_argument("--theta0", choices=("urdf", "zero"), default="urdf",
                     help="what the controller knows of the arm at the start (default: urdf)")  # fmt: skip
    run.add_argument("--plant", choices=("pinocchio", "mujoco"), default="pinocchio", help="the simulator")
    run.add_argument("--noise", type=float, default=0.0, metavar="SD",
                     help="of measured positions [rad] and velocities [rad/s] (default: 0)")  # fmt: skip
    run.add_argument("--seed", type=int, default=0, help="of the noise (default: 0)")
    run.add_argument("--duration", type=float, metavar="S",
                     help="of the run (default: the planned move and 1.5 s more, at least 4)")  # fmt: skip
    run.add_argument("--jump", action="store_true",
                     help="let the set-point jump, instead of moving it within the arm's limits, and leave "
                     "out the torque gate")  # fmt: skip
    run.add_argument(
        "--dt", type=float, default=1e-3, metavar="S", help="step of the controller (default: 0.001)"
    )
    run.add_argument("--live", action="store_true", help="show the arm in the browser while it moves")
    run.add_argument(
        "--view", action="store_true", help="show the motion in the browser afterwards, until Ctrl-C"
    )
    run.add_argument(
        "--no-certificates", action="store_true", help="leave out the conditions of the proofs (some seconds)"
    )
    run.add_argument("--out", type=Path, default=Path("out"), metavar="FOLDER",
                     help="for record (.npz), plot (.png) and report (.html) (default: out)")  # fmt: skip

    identify = command(
        "identify", identifying.identify,
        "tell an arm's parameters from a log of its motion, and write its URDF",
        "eladapt identify my_arm.urdf log.csv --out identified.urdf --report identified.html",
    )  # fmt: skip
    _robot(identify)
    identify.add_argument(
        "log", type=Path, metavar="LOG",
        help="a table (.csv, .tsv, .txt), .npz, a record of `eladapt run`, or a ROS 2 bag",
    )  # fmt: skip
    identify.add_argument(
        "--out", type=Path, metavar="URDF", help="write the robot's file with the new parameters"
    )
    identify.add_argument(
        "--report", type=Path, metavar="PAGE", help="write a page of what was found (.html)"
    )
    identify.add_argument("--held-out", type=float, default=0.3, metavar="SHARE",
                          help="the last part of the log, which only judges (default: 0.3)")  # fmt: skip
    identify.add_argument("--column", action="append", default=[], metavar="QUANTITY=NAMES",
                          help="which columns of a table are t, q, v, tau or current: names, numbers from 0 "
                          "or a pattern, as q='actual_q_*' or tau=14,15; repeatable (default: by the words "
                          "in the header)")  # fmt: skip
    identify.add_argument("--joint", action="append", metavar="NAME",
                          help="the joint of a column, in their order; repeatable (default: as the log says, "
                          "or the robot's)")  # fmt: skip
    identify.add_argument("--gains", type=_numbers, nargs="+", metavar="K",
                          help="torque by current [N m/A], one a joint, of a log of currents")  # fmt: skip
    identify.add_argument("--degrees", action="store_true",
                          help="positions and velocities are in "
                          "degrees (of joints that slide, in metres)")  # fmt: skip
    identify.add_argument("--held", action="store_true",
                          help="a torque acted over the whole step before its time, as commanded (default: "
                          "measured at that time)")  # fmt: skip
    identify.add_argument("--topic", metavar="NAME", help="of a ROS 2 bag with several of joint states")

    report = command(
        "report", running.report, "make one HTML page of a record, or a comparison of several",
        "eladapt report out/panda.npz out/other.npz --out comparison.html --label before after",
    )  # fmt: skip
    report.add_argument(
        "records",
        nargs="+",
        type=Path,
        metavar="RECORD",
        help="a file that `eladapt run` or Record.save wrote",
    )
    report.add_argument(
        "--out", type=Path, metavar="PAGE", help="the page (default: the first record's name with .html)"
    )
    report.add_argument(
        "--label", nargs="+", metavar="NAME", help="a name for each record (default: its title)"
    )
    _folders(report)
    report.add_argument(
        "--no-animation", action="store_true", help="leave out the motion in three dimensions (5 MB a record)"
    )

    stress = command(
        "stress", stressing.stress, "simulate an arm in random worlds, and say in how many it fails, and why",
        "eladapt stress panda --worlds 1000 --seed 0 --out stress_panda\n"
        "  eladapt stress panda --worlds 1000000 --out stress_panda --batch 20 --cluster tcp://10.0.0.1:8786"
        "\n\n"
        "The folder is added to as worlds are done: after a kill the same command goes on, and with more\n"
        "--worlds it adds them. exit code: 0, or 3 when worlds failed, 1 or 2 when something is wrong.",
    )  # fmt: skip
    _robot(stress)
    stress.add_argument("--worlds", type=int, default=1000, metavar="N", help="how many (default: 1000)")
    stress.add_argument("--seed", type=int, default=0, help="another one, other worlds (default: 0)")
    stress.add_argument(
        "--out", type=Path, required=True, metavar="FOLDER",
        help="for rows (.npy), summary (.txt) and report (.html)",
    )  # fmt: skip
    stress.add_argument("--jobs", type=int, metavar="J", help="processes (default: one a core)")
    stress.add_argument(
        "--cluster", metavar="ADDRESS", help="tcp://HOST:PORT of a dask scheduler, whose workers do the work"
    )
    stress.add_argument(
        "--batch", type=int, default=1, metavar="B",
        help="worlds that go to a process at once: 10 or more on a large cluster (default: 1)",
    )  # fmt: skip
    stress.add_argument(
        "--dt", type=float, default=1e-3, metavar="S", help="step of the controller (default: 0.001)"
    )

    command(
        "doctor",
        doctor.doctor,
        "say whether this computer has what eladapt needs, and how fast it is",
        "eladapt doctor",
    )

    completion = command(
        "completion", completing.completion,
        "print what makes a shell complete this command, for a file that the shell reads",
        "eladapt completion bash",
    )  # fmt: skip
    completion.add_argument("shell", choices=completing.SHELLS, metavar="SHELL",
                            help=f"one of {', '.join(completing.SHELLS)}")  # fmt: skip
    completion.set_defaults(whole=parser)
    return parser


def _robot(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "robot", metavar="ROBOT", help="a name that `eladapt robots` lists, or the path of a URDF"
    )
    _folders(parser)
    parser.add_argument("--lock", action="append", default=[], metavar="JOINT",
                        help="a joint to hold still, * matches any characters, mimic means all that "
                        "follow another; repeatable")  # fmt: skip
    parser.add_argument("--mend", action="store_true",
                        help="take the nearest physical inertia for a body that is none")  # fmt: skip
    parser.add_argument("--density", type=float, metavar="KG/M3",
                        help="weigh moving links that have no inertia by their shapes, of this density, "
                        "10 to 23000 (aluminium: 2700)")  # fmt: skip


def _folders(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--package-dir", action="append", default=[], metavar="FOLDER",
                        help="where package://NAME/ is found, and meshes may come from beside the URDF's "
                        "own folder; repeatable")  # fmt: skip


def _numbers(text: str) -> list[float]:
    """One number, or several between commas."""
    try:
        return [float(part) for part in text.split(",") if part.strip()]
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected a number, got {text!r}") from None
