"""Arguments and help texts of `flexarm`; nothing heavy is imported here."""

import argparse
import importlib
import os
import sys
from collections.abc import Sequence

from flexarm_env.cli.codes import BAD_INPUT, DONE, INTERRUPTED, sentence
from flexarm_env.training.arguments import Parser

OVERVIEW = """\
Robot arms whose links bend, in the plane and in space: replay scenes, compare with references, play, train, judge.

  flexarm scenes                                   what there is to replay
  flexarm replay robot_arm_motion                  run it and compare with its reference
  flexarm replay robot_arm_motion --plot arm.png   the same, with a figure
  flexarm simulate my_scene.toml --out run.csv     run a scene of your own
  flexarm view robot_arm_motion                    a page for the browser that plays it
  flexarm view two_link pd                         a policy beside a controller, in the same episode
  flexarm play FlexibleArm-v0 --policy lqr         watch a controller; without --policy, fly the arm yourself
  flexarm train --env FlexibleArm-v0               train a policy
  flexarm evaluate --policy pd,zvd,lqr             judge controllers and policies
  flexarm tune --env FlexibleArm-v0                tune the controllers' gains
  flexarm export two_link --to c --out two_link.c  a trained policy for a controller board
  flexarm export FlexibleArm-v0 --to fmu --out arm.fmu  an arm for another simulator, without Python
  flexarm serve FlexibleArm-v0 --rate 100          an arm that answers packets in real time
  flexarm bench                                    what is measured, and how (from a checkout)
  flexarm excite ARM --out FILE.csv                torques that tell what an arm is, within bounds
  flexarm identify ARM --config FILE --data LOG.csv  fit an arm to a measured log
  flexarm compile                                  compile beforehand what is used first
  flexarm doctor                                   versions, threads, cache, a self-test
"""

SCENES = """\
Without NAME: list the scenes that come with the package. With NAME: print that scene's TOML file,
a good start for one of your own.

  flexarm scenes
  flexarm scenes robot_arm_motion > my_scene.toml
  flexarm simulate my_scene.toml
"""

REPLAY = """\
Run a scene and print what it took, as `name: value` lines. A named scene that has a reference is compared
with it: max_tip_error and rms_tip_error, in m.

  flexarm replay robot_arm_motion
  flexarm replay robot_arm_motion --segments 8 --dt 0.025 --plot arm.png
  flexarm replay robot_arm_motion --formulation geometrically_exact --elements 8 --order 2
  flexarm replay flying_rod@as_printed --duration 5 --out rod.csv
  flexarm replay robot_arm_torque --video arm.mp4 --speed 2
  flexarm replay my_scene.toml --reference measured.csv --json
"""

SIMULATE = """\
Run a scene from a TOML file (or a named one) without comparing it with anything; the flags are those of replay.

  flexarm simulate my_scene.toml
  flexarm simulate my_scene.toml --formulation elastica --nodes 8 --out run.npz --plot run.png
  flexarm simulate configs/scenes/strip_slew.toml@hasty       (in a checkout)
  flexarm simulate my_scene.toml --strict --error-limit 0.01 || echo "not within 1 %"
"""

SOLVER_NOTE = """\
The scene's own defaults hold for what is not given. An option that the formulation lacks is an error.
"""

OUTPUT_NOTE = """\
exit code: 0 done, also where the status is inaccurate; 1 the run ended early (see status); 2 wrong input;
3 with --strict: the status is inaccurate
"""

VIEW = """\
One HTML file that plays runs in a browser, with no network and nothing installed: scrubbed, slowed, stepped, deflection
drawn larger, links coloured by curvature, charts beside it; several runs over each other or side by side.

RUN is a scene's name or TOML file, a trajectory's .npz, recorded episodes, a controller (pd, lqr, ...), a policy.npz, a
run folder, a policy that comes with the package, or a task of the suite: the best that is known there. Controllers play
in the environment of the first policy or task named.

  flexarm view robot_arm_motion
  flexarm view two_link pd --seed 7 --out two_link.html
  flexarm view slew-measured-v2 lqg --seed 10007
  flexarm view coarse.npz fine.npz --open
"""

PLAY = """\
An environment in a window. Keys: left and right turn the hub, up and down the elbow, shift is gentle, Esc ends.
A controller (pd, zv, zvd, lqr, lqg, mpc, time_optimal), a policy.npz, a run folder or a policy that comes with the
package plays by itself; each episode ends with a line of what came of it. A policy.npz holds numbers alone and names no
other environment than this package's, unless ENV names it too.

  flexarm play
  flexarm play TwoLinkFlexArm-v0 --policy lqr --episodes 3
  flexarm play --policy runs/ppo-FlexibleArm-v0-0 --seed 7 --video policy.mp4
  flexarm play --policy pd --episodes 20 --headless --record episodes.npz
"""

TRAINING = {
    "train": "train a policy",
    "evaluate": "judge policies and controllers",
    "tune": "tune the controllers' gains",
}
"""Commands that are programs of `flexarm_env.training`, which read their flags themselves."""

BENCH = """\
Judge policies on the suite's tasks (suite), make a page of the results (page), or run a benchmark of a checkout
(benchmarks/NAME.py); all flags behind NAME go there. Without NAME: list them.

  flexarm bench
  flexarm bench suite --policy pd,lqg
  flexarm bench suite --help
  flexarm bench throughput
  flexarm bench throughput --help
"""

CODES_NOTE = """\
exit code: 0 done, 2 wrong input, or something is missing
"""

IDENTIFY_CODES = """\
exit code: 0 done, 1 the fit is poor (see verdict), 2 wrong input or a log that cannot be used
"""

IDENTIFY = """\
Fit an arm to measured logs, say what the fit is worth, and judge it on logs that it has not seen. The config, a small
TOML file, says what the columns are and what is fitted (configs/identify/ in a checkout has examples).

  flexarm identify quanser_2dsfl --config configs/identify/quanser_2dsfl.toml --data A.csv --hold-out B.csv,C.csv \\
      --out RESULTS

Prints vaf.STEM.OUTPUT in % for each run held out; those of training, of the arm before the fit and of one oscillator an
output stand under train., unfitted. and baseline. RESULTS holds arm.toml, which every command takes, a report and
figures; an interrupted fit goes on from there.
"""

EXCITE = """\
Design torques that excite an arm's joints and first modes, and keep angles, torques and deflections within bounds, of
the arm as it is known and of some that differ from it by as much as --spread. It ends where it began, at rest.

  flexarm excite strip --rate 200 --seconds 10 --most-angle 0.3 --out excite.csv
  flexarm serve my_robot.toml --rate 200 --log log.csv          (or the robot itself)
  flexarm run excite.csv --to 127.0.0.1:7070 --most-angle 0.6
  flexarm identify strip --config FILE --data log.csv

What friction and a base that is not level add is not foreseen: set limits where it is played, too.
"""

EXCITED: tuple[tuple[str, float | None, str, str], ...] = (
    ("--seconds", 20.0, "T", "how long (20)"),
    ("--rate", 100.0, "HZ", "at which torques change (100)"),
    ("--modes", 2, "N", "flexible modes that are to be excited (2)"),
    ("--most-angle", 0.5, "RAD", "that a joint may turn to either side (0.5)"),
    ("--most-torque", None, "NM", "of a motor; default: half of its limit"),
    ("--most-deflection", 0.15, "SHARE", "of a tip, over its link's length (0.15)"),
    ("--drawn", 8, "N", "arms beside the known one (8)"),
    ("--spread", 2.0, "FACTOR", "by which their EI, payload, hub and damping may differ (2)"),
    ("--seed", 0, "S", "of phases and of these arms (0)"),
)
"""Arguments of `flexarm_env.identification.excite`: flag, default, what stands for it, help."""

EXPORT = """\
Write a trained policy, or an arm, for other machines.

A policy decides there as NumPy does, to 1e-6. --to c: one C99 file without main, float32, arrays of fixed size, no
allocation; scaling, clipping, normalisation and history are in it, and its first lines say what to call. --to onnx:
observations (n, entries) to actions (n, joints), for any runtime (pip install onnx). WHAT is a run folder, a policy.npz
or the name of a policy that comes with the package.

A controller leaves as C (--to c) in double precision, with what its design came to: pd, zv, zvd, lqr, lqg and the plan
of time_optimal (--slew, one link). Gains that depend on where elbows are, all but pd's, are held 0.1 rad apart: on two
links for all angles, or for those of --elbows, which three links and more ask for.

An arm moves there with the bits that it has in Python. --to library: a folder with a shared object that wants no
Python, a header that says all, an example, a CMake file and a pkg-config file. WHAT is an environment's id, a task of
the suite, or an arm, by its name or its TOML file. Linux on x86-64; the C compiler there links it. --to fmu: the same
as a functional mock-up unit for co-simulation, for any tool that imports FMI; of a controller (--env) a unit for it.

  flexarm export two_link --to c --out two_link.c
  flexarm export runs/ppo-FlexibleArm-v0-0 --to onnx --out arm.onnx
  flexarm export lqr --to c --env FlexibleArm-v0 --out lqr.c
  flexarm export TwoLinkFlexArm-v0 --to library --out my_arm --env-kwargs '{"formulation": "geometrically_exact"}'
"""

SERVE = """\
Step an arm in real time and answer packets over UDP: torques or joint angles in, what its sensors read out. The packet
is a table of the documentation; flexarm run, RemoteArm-v0 or anything else that speaks it is the other side. An arm is
armed by its peer, and held where no command comes for some periods, until it is armed again. Limits clip what is asked
for, or hold the arm. This machine alone is listened to unless --host names another address, which wants --key or
--insecure. This is no safety system.

  flexarm serve FlexibleArm-v0 --rate 100
  flexarm serve my_arm.toml --rate 500 --hold angles --most-rate 20 --log run.csv
"""

RUN = """\
Drive an arm that answers packets, a served one or a real one, by a trained policy or a controller. What it reads must
be what the policy's environment observes. A file of torques, FILE.csv with t, torque0, ... (flexarm excite), is played
as it is, a row a period. MODULE:NAME is a Python function of observations, or a class with reset and act.

  flexarm run pd --env FlexibleArm-v0 --to 127.0.0.1:7070 --seconds 5
  flexarm run runs/ppo-FlexibleArm-v0-0 --to 192.168.0.7:7070 --key FILE
"""

COMPILE = """\
Compile what FlexibleArm-v0 and TwoLinkFlexArm-v0 (single and vector), simulate, replay and linearize need in their
default settings, and keep it, for every process on this machine; says which of how many it is at, and what is there is
not compiled again. Other environments, and elements, nodes and modes of your own, are compiled on their first use.
What can be kept nowhere is an error: FLEXARM_CACHE_DIR says where.

  flexarm compile
  flexarm compile --all                            every formulation
  FLEXARM_CACHE_DIR=/shared/cache flexarm compile    for all machines with like processors
"""

DOCTOR = """\
Versions, processors and threads, the folder of compiled code, and a self-test, which the first time compiles and says
so: a scene, and a step of FlexibleArm-v0 and TwoLinkFlexArm-v0 and their vectors. The exit code is 1 where it fails.
"""


SOLVER: tuple[tuple[str, type, str, str], ...] = (
    ("segments", int, "N", "bodies a link is cut into (floating_frame)"),
    ("elements", int, "N", "per segment (floating_frame), per link (geometrically_exact)"),
    ("frame", str, "NAME", "chord or root: where the frame floats (floating_frame)"),
    ("coupling", str, "NAME", "von_karman, paper or linear (floating_frame)"),
    ("modes", int, "N", "bending modes per link, per segment with --segments (floating_frame)"),
    ("multipliers", bool, "", "bodies joined by Lagrange multipliers, the paper's own form (floating_frame)"),
    ("order", int, "P", "of the elements, 1 to 3 (geometrically_exact)"),
    ("nodes", int, "N", "per link, 3 to 12 (elastica)"),
    ("dt", float, "H", "step, s"),
    ("rho_inf", float, "R", "numerical damping: 1 none, 0 most"),
    ("tolerance", float, "T", "of the Newton iteration"),
    ("step_tolerance", float, "E",
     "halve dt where a stretch between samples would add more error than this, a fraction of the length"),
    ("period_correction", bool, "", "take the integrator's error of the period out of each step of the exact beam"),
)  # fmt: skip
"""Options of `flexarm_env.settings` that `replay` and `simulate` take: name, kind, what stands for it, help."""


def _add_run(parser: argparse.ArgumentParser, reference: bool) -> None:
    """Flags of `replay` and `simulate`; their names are the options' names everywhere."""
    solver = parser.add_argument_group("how it is computed", SOLVER_NOTE)
    solver.add_argument("--formulation", metavar="NAME", help="floating_frame, geometrically_exact or elastica")
    for name, kind, metavar, text in SOLVER:
        flag = "--" + name.replace("_", "-")
        if kind is bool:
            solver.add_argument(flag, action=argparse.BooleanOptionalAction, default=None, help=text)
        else:
            solver.add_argument(flag, type=kind, metavar=metavar, help=text)
    run = parser.add_argument_group("what is run and compared")
    run.add_argument("--duration", type=float, metavar="T", help="how long to run, s")
    run.add_argument("--sample", type=float, metavar="DT", help="sampling interval of the output, s")
    run.add_argument(
        "--error-limit", type=float, metavar="E", default=0.05,
        help="status inaccurate where error_estimate (fraction of the arm's length) is above this (0.05)",
    )  # fmt: skip
    run.add_argument("--strict", action="store_true", help="exit code 3 where the status is inaccurate")
    run.add_argument("--time-limit", type=float, metavar="T", help="s by the clock, then the run fails (timed_out)")
    if reference:
        run.add_argument(
            "--reference", metavar="FILE.csv",
            help="compare with this file: t, and tip_x and tip_y, tip_angle or start_angle; default: the scene's own",
        )  # fmt: skip
    run.add_argument("--through-env", action="store_true", help="go through the environment's step; the same numbers")
    output = parser.add_argument_group("output")
    output.add_argument("--out", metavar="FILE", help="trajectory: .csv (t, energy, start, tip, hinges) or .npz (all)")
    output.add_argument("--plot", metavar="FILE", help="figure of shapes, tip deflection, energy: .png, .pdf or .svg")
    output.add_argument("--plots", metavar="FOLDER", help="all figures of the run: shapes, energies, spectrum")
    output.add_argument("--video", metavar="FILE", help="film of the run: .mp4, .gif, .webm, .mkv or .mov")
    output.add_argument("--speed", type=float, metavar="S", help="seconds of the run a second of film (1)")


def build_parser() -> Parser:
    """The parser of the whole command."""
    from flexarm_env import __version__

    parser = Parser(prog="flexarm", description=OVERVIEW, epilog="flexarm COMMAND --help says more about each.")
    parser.add_argument("--version", action="version", version=f"flexarm_env {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", parser_class=Parser)

    def add(name: str, summary: str, description: str, module: str, epilog: str = CODES_NOTE) -> Parser:
        command: Parser = commands.add_parser(name, help=summary, description=description, epilog=epilog)
        command.set_defaults(module=module)
        if module != "checkout":
            command.add_argument("--json", action="store_true", help="print one JSON object instead of text")
        return command

    scenes = add("scenes", "list the scenes that come with the package", SCENES, "scenes")
    scenes.add_argument("name", nargs="?", metavar="NAME", help="print this scene's TOML file")

    replay = add("replay", "run a scene and compare it with its reference", REPLAY, "replay", OUTPUT_NOTE)
    replay.add_argument("scene", metavar="SCENE", help="a name, NAME@as_printed, or a TOML file (FILE.toml@SET)")
    _add_run(replay, reference=True)

    simulate = add("simulate", "run a scene of your own", SIMULATE, "replay", OUTPUT_NOTE)
    simulate.add_argument("scene", metavar="FILE", help="a TOML file (FILE.toml@SET for a parameter set), or a name")
    _add_run(simulate, reference=False)

    view = add("view", "a page that plays runs in a browser", VIEW, "view")
    view.add_argument("runs", nargs="+", metavar="RUN", help="scene, trajectory, episodes, controller or policy")
    view.add_argument("--out", metavar="FILE.html", help="the page; default: the first run's name, here")
    view.add_argument("--title", metavar="TEXT", help="over the page; default: the runs' names")
    view.add_argument("--open", action="store_true", help="show it in the browser")
    view.add_argument("--env", metavar="ENV", help="of controllers, and of episodes of another package's environment")
    view.add_argument("--seed", type=int, metavar="S", help="of the episode that is played (0; of a record 10000)")
    view.add_argument("--episode", type=int, metavar="K", help="of a file with several (0: the first)")
    view.add_argument("--formulation", metavar="NAME", help="of scenes: floating_frame, geometrically_exact, elastica")
    view.add_argument("--duration", type=float, metavar="T", help="of scenes: how long to run, s")
    view.add_argument("--sample", type=float, metavar="DT", help="of scenes: s from instant to instant")

    play = add("play", "fly an arm, or watch a controller or a policy", PLAY, "play")
    play.add_argument("env", nargs="?", metavar="ENV", help="its id, a task's of the suite too (FlexibleArm-v0)")
    play.add_argument("--policy", default="keyboard", metavar="WHO", help="keyboard (default), controller or policy")
    play.add_argument("--episodes", type=int, default=1, metavar="N", help="how many (1)")
    play.add_argument("--seed", type=int, default=0, metavar="S", help="of the first; the others follow (0)")
    play.add_argument("--env-kwargs", metavar="JSON", help="keywords of the environment: '{\"duration\": 8}'")
    play.add_argument("--video", metavar="FILE", help="a film instead of a window: .mp4, .gif, .webm, .mkv or .mov")
    play.add_argument("--headless", action="store_true", help="no window; only print what came of the episodes")
    play.add_argument("--record", metavar="FILE.npz", help="keep the episodes (flexarm_env.recording.load_episodes)")

    for name, summary in TRAINING.items():
        add(name, summary, "", "training")
    bench = add("bench", "judge policies on the suite, or run a benchmark", BENCH, "checkout", "")
    bench.usage = "%(prog)s [NAME [FLAGS]]"

    identify = add("identify", "fit an arm to measured logs", IDENTIFY, "identify", IDENTIFY_CODES)
    identify.add_argument("arm", metavar="ARM", help="where the fit begins: a name or a TOML file")
    identify.add_argument("--config", required=True, metavar="FILE", help="columns, units, filters, parameters: TOML")
    identify.add_argument("--data", required=True, metavar="A.csv[,...]", help="logs to fit to")
    identify.add_argument("--fit", metavar="NAME[,NAME...]", help="parameters to fit; default: the config's")
    identify.add_argument("--hold-out", metavar="B.csv[,...]", help="logs to judge by")
    identify.add_argument("--out", metavar="FOLDER", help="for arm.toml, report.md, figures; an old fit there goes on")

    excite = add("excite", "torques that tell what an arm is, within bounds", EXCITE, "identify")
    excite.add_argument("arm", metavar="ARM", help="what is known of it: a name or a TOML file")
    excite.add_argument("--out", required=True, metavar="FILE.csv", help="what flexarm run plays: t, torque0, ...")
    for flag, default, metavar, what in EXCITED:
        kind = float if default is None else type(default)
        excite.add_argument(flag, type=kind, default=default, metavar=metavar, help=what)

    serve = add("serve", "an arm that answers packets in real time", SERVE, "remote")
    serve.add_argument("what", metavar="ARM", help="an environment, a task or an arm, as for export --to library")
    serve.add_argument("--rate", type=float, default=100.0, metavar="HZ", help="control periods a second (100)")
    serve.add_argument("--host", default="127.0.0.1", metavar="ADDRESS", help="where to listen (this machine alone)")
    serve.add_argument("--port", type=int, default=7070, metavar="N", help="and at which port; 0: any (7070)")
    serve.add_argument("--key", metavar="FILE", help="shared with the peer: every packet is signed")
    serve.add_argument("--insecure", action="store_true", help="listen beyond this machine without a key")
    serve.add_argument("--watchdog", type=int, default=5, metavar="N", help="periods without a command it bears (5)")
    serve.add_argument("--hold", choices=("zero", "angles"), default="zero", help="then: no torque, or angles held")
    serve.add_argument("--most-angle", type=float, metavar="RAD", help="of a joint; beyond, the arm is held")
    serve.add_argument("--most-rate", type=float, metavar="RAD/S", help="likewise of its rate")
    serve.add_argument("--most-change", type=float, metavar="SHARE", help="of a torque in a period, of its limit")
    serve.add_argument("--env-kwargs", metavar="JSON", help="keywords of the environment")
    serve.add_argument("--seed", type=int, metavar="S", help="of the arm's start")
    serve.add_argument("--log", metavar="FILE.csv", help="a row a period, as flexarm identify reads")
    serve.add_argument("--seconds", type=float, metavar="T", help="how long; default: until Ctrl-C")

    run = add("run", "drive an arm that answers packets", RUN, "remote")
    run.add_argument("policy", metavar="POLICY", help="run folder, policy.npz, packaged policy, controller, FILE.csv")
    run.add_argument("--to", required=True, metavar="HOST:PORT", help="where the arm answers")
    run.add_argument("--key", metavar="FILE", help="shared with it")
    run.add_argument("--env", metavar="ENV", help="of a controller's model")
    run.add_argument("--env-kwargs", metavar="JSON", help="its keywords")
    run.add_argument("--seconds", type=float, metavar="T", help="how long (10; of a file: as long as it is)")
    run.add_argument("--most-angle", type=float, metavar="RAD", help="of a joint; beyond, it lets go of the arm")
    run.add_argument("--most-rate", type=float, metavar="RAD/S", help="likewise of its rate")

    export = add("export", "policies as ONNX or C, controllers as C, arms as C libraries or FMUs", EXPORT, "export")
    what = "a policy or a controller; for --to library or fmu an environment, a task or an arm"
    export.add_argument("what", metavar="WHAT", help=what)
    export.add_argument("--to", required=True, choices=("onnx", "c", "library", "fmu"), help="the form")
    export.add_argument("--out", required=True, metavar="PATH", help="the file, .onnx, .c, .fmu; a library's folder")
    export.add_argument("--name", metavar="NAME", help="in front of all that a library defines; default: by --out")
    export.add_argument("--fmi", choices=("2.0", "3.0"), help="version of the standard; default 3.0")
    export.add_argument("--cpu", metavar="CPU", help="native, or by LLVM's name, to build for; default x86-64-v2")
    export.add_argument("--env", metavar="ENV", help="of a controller: what it is designed for")
    export.add_argument("--env-kwargs", metavar="JSON", help="keywords of the environment")
    export.add_argument("--slew", type=float, metavar="RAD", help="of time_optimal: the slew that is planned")
    what = "angles of each elbow that a controller's gains are held for, rad"
    export.add_argument("--elbows", metavar="LOW:HIGH[,...]", help=what)
    export.add_argument("--targets", metavar="X:Y:Z[,...]", help="in space: points whose rests a controller holds, m")

    compile_ = add("compile", "compile beforehand what is used first", COMPILE, "compile", "")
    compile_.add_argument("--all", action="store_true", help="every formulation, not the default ones alone")

    add("doctor", "versions, threads, cache and a self-test", DOCTOR, "doctor", "")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code (and raises SystemExit for --help and wrong flags)."""
    parser = build_parser()
    words = list(sys.argv[1:] if arguments is None else arguments)
    if words and (words[0] in TRAINING or (words[0] == "bench" and words[1:] not in (["--help"], ["-h"]))):
        module = "checkout" if words[0] == "bench" else "training"
        args = argparse.Namespace(command=words[0], module=module, words=words[1:])
    else:
        args, more = parser.parse_known_args(words)
        if more:
            told = next(part for part in parser._actions if isinstance(part, argparse._SubParsersAction))
            told.choices.get(args.command, parser).unknown(more)
    if args.command is None:
        parser.print_help()
        return DONE
    from gymnasium.error import DependencyNotInstalled

    try:
        if args.module == "training":
            program = importlib.import_module(f"flexarm_env.training.{args.command}")
            code: int = program.main(f"flexarm {args.command}", args.words)
        else:
            code = importlib.import_module(f"flexarm_env.cli.{args.module}").run(args)
        sys.stdout.flush()
    except BrokenPipeError:  # the reader has seen enough (`flexarm scenes | head`)
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except (ValueError, OSError, ImportError, MemoryError, DependencyNotInstalled) as error:
        sys.stderr.write(f"flexarm {args.command}: {sentence(error)}\n")
        return BAD_INPUT
    except KeyboardInterrupt:
        sys.stderr.write(f"flexarm {args.command}: interrupted\n")
        return INTERRUPTED
    return code
