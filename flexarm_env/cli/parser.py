"""Arguments and help texts of `flexarm`. This module imports only modules that are fast to import."""

import argparse
import importlib
import os
import sys
import warnings
from collections.abc import Sequence

from flexarm_env.cli.codes import BAD_INPUT, DONE, INTERRUPTED, sentence
from flexarm_env.cli.exchange_texts import EXPORT, FORMS, IMPORT, SCHEMA
from flexarm_env.records import add_flags
from flexarm_env.settings import Settings
from flexarm_env.training.arguments import Parser

OVERVIEW = """\
Robot arms with flexible links, in the plane and in space: simulate, train, evaluate, fit and export.

  flexarm scenes                                   list the scenes of the package
  flexarm replay robot_arm_motion --plot arm.png   simulate a scene, compare it with its reference, plot it
  flexarm simulate my_scene.toml --out run.csv     simulate a scene of your own
  flexarm view robot_arm_motion                    write an HTML page that shows the motion
  flexarm view two_link pd                         show a policy and a controller in the same episode
  flexarm arm my_arm.toml                          print an arm's time scales, frequencies and margins
  flexarm schema > arm.schema.json                 write the JSON schema of arm files (or scenes), for editors
  flexarm play FlexibleArm-v0 --policy lqr         watch a controller; without --policy, use the keyboard
  flexarm train --env FlexibleArm-v0               train a policy
  flexarm evaluate --policy pd,zvd,lqr             evaluate controllers and policies
  flexarm tune --env FlexibleArm-v0                tune the controllers' gains
  flexarm export two_link --to c --out two_link.c  export a trained policy as C
  flexarm export FlexibleArm-v0 --to fmu --out arm.fmu  export an arm for another simulator
  flexarm export strip --to mjcf --out strip.xml   export an arm as a MuJoCo model, or as URDF for ROS
  flexarm import robot.urdf --out robot.toml       convert a robot's description to an arm
  flexarm serve FlexibleArm-v0 --rate 100          simulate an arm in real time, controlled over UDP
  flexarm run pd --env FlexibleArm-v0 --to 127.0.0.1:7070  control a served or real arm
  flexarm bench                                    list benchmarks; `bench suite` evaluates policies
  flexarm excite ARM --out FILE.csv                design torques that excite an arm for identification
  flexarm identify ARM --config FILE --data LOG.csv  fit an arm to a measured log
  flexarm compile                                  compile the programs for default settings in advance
  flexarm doctor                                   print versions, threads, cache; run a self-test
"""

SCENES = """\
Without NAME: list the scenes of the package. With NAME: print that scene's TOML file, a template for your own.

  flexarm scenes robot_arm_motion > my_scene.toml
  flexarm simulate my_scene.toml
"""

REPLAY = """\
Simulate a scene and print a report as `name: value` lines. If the scene has a reference solution, the report contains
the largest and the root-mean-square distance of the tip from the reference, max_tip_error and rms_tip_error, in m.

  flexarm replay robot_arm_motion
  flexarm replay robot_arm_motion --segments 8 --dt 0.025 --plot arm.png
  flexarm replay robot_arm_motion --formulation geometrically_exact --elements 8 --order 2
  flexarm replay flying_rod@as_printed --duration 5 --out rod.csv
  flexarm replay robot_arm_torque --video arm.mp4 --speed 2
  flexarm replay my_scene.toml --reference measured.csv --json
"""

SIMULATE = """\
Simulate a scene from a TOML file, or a scene of the package, without a comparison. The flags are those of replay.

  flexarm simulate my_scene.toml
  flexarm simulate my_scene.toml --formulation elastica --nodes 8 --out run.npz --plot run.png
  flexarm simulate configs/scenes/strip_slew.toml@hasty       (in a checkout)
  flexarm simulate my_scene.toml --strict --error-limit 0.01 || echo "not within 1 %"
"""

SOLVER_NOTE = """\
The scene defines the defaults. An option that the formulation does not have causes an error.
"""

OUTPUT_NOTE = """\
exit code: 0 done, even if the status is inaccurate; 1 the simulation ended early (see status); 2 wrong input;
3 with --strict: the status is inaccurate
"""

VIEW = """\
Write one HTML file that shows simulations or episodes in a browser, without network access or installation. The player
can scrub, slow down, single-step, magnify deflections and color links by curvature. It shows charts, and shows several
runs in one picture or side by side.

RUN is a scene's name or TOML file, a trajectory's .npz, a file of recorded episodes, a controller (pd, lqr, ...), a
policy, or a task of the suite, whose best known episode is shown. A policy is the name of a policy of the package, a
run folder, a file (policy.npz, a .zip of Stable-Baselines3, .onnx), or MODULE:NAME, a Python function of observations
or a class with reset and act. Controllers and functions act in the environment of the first policy or task in the
list.

  flexarm view robot_arm_motion
  flexarm view two_link pd --seed 7 --out two_link.html
  flexarm view slew-measured-v2 lqg --seed 10007
  flexarm view lqr --env-kwargs '{"arm": "my_arm.toml"}'
  flexarm view coarse.npz fine.npz --open
"""

ARM = """\
Print the properties of an arm that matter for control and learning: the duration of the fastest quarter turn of each
joint, the lowest natural frequencies and damping ratios with free joints, a suitable episode duration, control period
and discount factor, and the gain and delay margins of the controllers with the package's gains.

  flexarm arm strip
  flexarm arm my_arm.toml --env-kwargs '{"actuator": {"lag": 0.02}, "control_dt": 0.01}'
"""

PLAY = """\
Show an environment in a window. The keys left and right turn the hub, up and down turn the elbow, shift reduces the
torque, and Esc quits. With --policy, a controller (pd, zv, zvd, lqr, lqg, mpc, time_optimal) or a policy acts instead.
A policy is the name of a policy of the package, a run folder, a file (policy.npz, a .zip of Stable-Baselines3, .onnx),
or MODULE:NAME, a Python function of observations or a class with reset and act. After each episode one line summarizes
it.

The command reads only numbers from policy files and executes no code from them. If a policy.npz names an environment
of another package, ENV must name the same environment.

  flexarm play
  flexarm play TwoLinkFlexArm-v0 --policy lqr --episodes 3
  flexarm play --policy runs/ppo-FlexibleArm-v0-0 --seed 7 --video policy.mp4
  flexarm play --policy pd --episodes 20 --headless --record episodes.npz
"""

TRAINING = {
    "train": "train a policy",
    "evaluate": "evaluate policies and controllers",
    "tune": "tune the controllers' gains",
}
"""Commands of `flexarm_env.training`, whose programs parse their own flags."""

BENCH = """\
NAME is suite (evaluate policies on the suite's tasks), page (summarize results on a page), or the name of a benchmark
in a checkout (benchmarks/NAME.py), which receives all flags after NAME. Without NAME: list the benchmarks.

  flexarm bench suite --policy pd,lqg
  flexarm bench suite --help
  flexarm bench throughput --help
"""

CODES_NOTE = """\
exit code: 0 done, 2 wrong input or a missing file or package
"""

RUN_CODES = """\
exit code: 0 done, 2 wrong input or a missing file or package, 4 the run ended before --seconds (see ended)
"""

IDENTIFY_CODES = """\
exit code: 0 done, 1 the fit is poor (see verdict), 2 wrong input or an unusable log
"""

IDENTIFY = """\
Fit an arm to measured logs, compute confidence intervals of the parameters, and validate the arm on other logs. The
config, a TOML file, describes the columns and the parameters to fit (examples: configs/identify/ in a checkout).

  flexarm identify quanser_2dsfl --config configs/identify/quanser_2dsfl.toml --data A.csv --hold-out B.csv,C.csv \\
      --out RESULTS

The command prints vaf.STEM.OUTPUT, the variance accounted for in the held-out log STEM.csv, in %. Names with the prefix
train. refer to the fitted logs, with unfitted. to the arm before the fit, and with baseline. to one linear oscillator
for each output. The folder RESULTS contains arm.toml, which every command accepts, a report and figures. If the command
is interrupted, run it again with the same folder to resume the fit.
"""

EXCITE = """\
Design torques that excite an arm's joints and first modes. The motion starts and ends at rest. Angles, torques and
deflections stay within bounds, for the given arm and for arms whose parameters differ by factors up to --spread.

  flexarm excite strip --rate 200 --seconds 10 --most-angle 0.3 --out excite.csv
  flexarm serve my_robot.toml --rate 200 --log log.csv          (or the server of the real robot)
  flexarm run excite.csv --to 127.0.0.1:7070 --most-angle 0.6
  flexarm identify strip --config FILE --data log.csv

The design ignores joint friction and gravity. Therefore also set limits in the program that applies the torques.
"""

EXCITED: tuple[tuple[str, float | None, str, str], ...] = (
    ("--seconds", 20.0, "T", "duration, s (20)"),
    ("--rate", 100.0, "HZ", "rate at which torques change (100)"),
    ("--modes", 2, "N", "number of flexible modes to excite (2)"),
    ("--most-angle", 0.5, "RAD", "largest joint rotation to either side (0.5)"),
    ("--most-torque", None, "NM", "largest joint torque; default: half of each joint's limit"),
    ("--most-deflection", 0.15, "SHARE", "largest tip deflection divided by the link's length (0.15)"),
    ("--drawn", 8, "N", "number of other arms for which the bounds must hold (8)"),
    ("--spread", 2.0, "FACTOR", "their EI, payload, hub inertia and damping differ by 1/FACTOR to FACTOR (2)"),
    ("--seed", 0, "S", "seed of the phases and of the other arms (0)"),
)
"""Arguments of `flexarm_env.identification.excite`: flag, default, placeholder of the value, help."""

SERVE = """\
Simulate an arm in real time. A client sends torques or joint angles in UDP packets, and the server answers with sensor
readings. The client is flexarm run, the environment RemoteArm-v0 or your own program; the documentation (Real-time
control over UDP) describes the packets. At first the arm is held, until the client sends a command with the flag ARM.
If no command arrives for --watchdog periods, or if a joint exceeds a limit, the arm is held again until the next such
command. The server accepts clients on other machines only if --host names another address, which requires --key or
--insecure. The server does not make a real arm safe.

  flexarm serve FlexibleArm-v0 --rate 100
  flexarm serve my_arm.toml --rate 500 --hold angles --most-rate 20 --log run.csv
"""

RUN = """\
Control a served or real arm by a trained policy or a controller. The arm's sensor readings must be the observations of
the policy's environment. POLICY is a controller, a run folder, a file, or MODULE:NAME, a Python function of
observations or a class with reset and act, as for flexarm play. If POLICY is FILE.csv with the columns t, torque0, ...
(from flexarm excite), one row of torques is applied in each period.

  flexarm run pd --env FlexibleArm-v0 --to 127.0.0.1:7070 --seconds 5
  flexarm run runs/ppo-FlexibleArm-v0-0 --to 192.168.0.7:7070 --key FILE
"""

COMPILE = """\
Compile programs in advance, and store them for all processes on this machine. These are the programs that
FlexibleArm-v0 and TwoLinkFlexArm-v0 (single and vector), play, view, evaluate, train, simulate, replay and linearize
use with default settings. The command prints its progress and skips programs that are already compiled. Programs for
other environments, and for other numbers of elements, nodes and modes, are compiled at their first use. If the cache
folder is not writable, the command fails; set FLEXARM_CACHE_DIR to another folder.

  flexarm compile
  flexarm compile --all                            every formulation
  FLEXARM_CACHE_DIR=/shared/cache flexarm compile    for all machines with the same processor type
"""

DOCTOR = """\
Print versions, processors, threads and the cache folder, and run a self-test: a scene, and one step of FlexibleArm-v0,
TwoLinkFlexArm-v0 and their vector environments. The first self-test takes longer, because it compiles the programs. The
exit code is 1 if the test fails.
"""


def _add_run(parser: argparse.ArgumentParser, reference: bool) -> None:
    """Add the flags of `replay` and `simulate`, which have the names of the options in Python."""
    add_flags(parser.add_argument_group("solver", SOLVER_NOTE), Settings)
    run = parser.add_argument_group("run and comparison")
    run.add_argument("--duration", type=float, metavar="T", help="duration, s")
    run.add_argument("--sample", type=float, metavar="DT", help="sampling interval of the output, s")
    run.add_argument(
        "--error-limit", type=float, metavar="E", default=0.05,
        help="the status is inaccurate if the estimated tip error, divided by the arm's length, exceeds E (0.05)",
    )  # fmt: skip
    run.add_argument("--strict", action="store_true", help="exit code 3 if the status is inaccurate")
    run.add_argument("--time-limit", type=float, metavar="T", help="largest wall time, s; then the status is timed_out")
    if reference:
        run.add_argument(
            "--reference", metavar="FILE.csv",
            help="reference: columns t, and tip_x and tip_y, tip_angle or start_angle; default: the scene's reference",
        )  # fmt: skip
    run.add_argument("--through-env", action="store_true", help="simulate by an environment's step; same results")
    output = parser.add_argument_group("output")
    output.add_argument("--out", metavar="FILE", help="trajectory: .csv (time, energy, positions) or .npz (all arrays)")
    output.add_argument("--units", action="store_true", help="write units in the header of the .csv, as in 't (s)'")
    output.add_argument("--plot", metavar="FILE", help="figure of shapes, tip deflection, energy: .png, .pdf or .svg")
    output.add_argument("--plots", metavar="FOLDER", help="all figures of the run: shapes, energies, spectrum")
    output.add_argument("--video", metavar="FILE", help="video of the run: .mp4, .gif, .webm, .mkv or .mov")
    output.add_argument("--speed", type=float, metavar="S", help="simulated seconds per second of video (1)")


def build_parser() -> Parser:
    """Return the parser of the whole command."""
    from flexarm_env import __version__

    parser = Parser(prog="flexarm", description=OVERVIEW, epilog="flexarm COMMAND --help explains each command.")
    parser.add_argument("--version", action="version", version=f"flexarm_env {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", parser_class=Parser)

    def add(name: str, summary: str, description: str, module: str, epilog: str = CODES_NOTE) -> Parser:
        """Add a command with `--json`, which the module `cli.<module>` runs; return the command's parser."""
        command: Parser = commands.add_parser(name, help=summary, description=description, epilog=epilog)
        command.set_defaults(module=module)
        if module != "checkout":
            command.add_argument("--json", action="store_true", help="print one JSON object instead of text")
        return command

    scenes = add("scenes", "list the scenes of the package", SCENES, "scenes")
    scenes.add_argument("name", nargs="?", metavar="NAME", help="print this scene's TOML file")

    replay = add("replay", "simulate a scene and compare it with its reference", REPLAY, "replay", OUTPUT_NOTE)
    replay.add_argument("scene", metavar="SCENE", help="name or TOML file; @SET after it selects a parameter set")
    _add_run(replay, reference=True)

    simulate = add("simulate", "simulate a scene of your own", SIMULATE, "replay", OUTPUT_NOTE)
    simulate.add_argument("scene", metavar="FILE", help="TOML file or name; @SET after it selects a parameter set")
    _add_run(simulate, reference=False)

    view = add("view", "write a page that shows simulations and episodes", VIEW, "view")
    view.add_argument("runs", nargs="+", metavar="RUN", help="scene, trajectory, episodes, controller or policy")
    view.add_argument("--out", metavar="FILE.html", help="output file; default: named after the first RUN")
    view.add_argument("--title", metavar="TEXT", help="title of the page; default: names of all RUNs")
    view.add_argument("--open", action="store_true", help="open the page in the browser")
    view.add_argument("--env", metavar="ENV", help="environment for controllers, or of episodes of another package")
    view.add_argument("--env-kwargs", metavar="JSON", help="keywords of the environment: '{\"arm\": \"my_arm.toml\"}'")
    view.add_argument("--seed", type=int, metavar="S", help="seed of the episode (0; for a task of the suite 10000)")
    view.add_argument("--episode", type=int, metavar="K", help="index of the episode in a file (0: the first)")
    view.add_argument("--formulation", metavar="NAME", help="for scenes: floating_frame, geometrically_exact, elastica")
    view.add_argument("--duration", type=float, metavar="T", help="for scenes: duration, s")
    view.add_argument("--sample", type=float, metavar="DT", help="for scenes: time between two pictures, s")

    arm = add("arm", "print an arm's time scales, frequencies and margins", ARM, "arm")
    arm.add_argument("arm", metavar="ARM", help="name or TOML file of an arm")
    arm.add_argument("--env-kwargs", metavar="JSON", help="keywords of the environment")

    play = add("play", "control an arm by keyboard, or watch a controller or a policy", PLAY, "play")
    play.add_argument("env", nargs="?", metavar="ENV", help="environment id or task of the suite (FlexibleArm-v0)")
    play.add_argument("--policy", default="keyboard", metavar="POLICY", help="keyboard (default), controller or policy")
    play.add_argument("--episodes", type=int, default=1, metavar="N", help="number of episodes (1)")
    play.add_argument("--seed", type=int, default=0, metavar="S", help="seed of the first episode (0); the next: S + 1")
    play.add_argument("--env-kwargs", metavar="JSON", help="keywords of the environment: '{\"duration\": 8}'")
    play.add_argument("--video", metavar="FILE", help="write a video, show no window: .mp4, .gif, .webm, .mkv or .mov")
    play.add_argument("--headless", action="store_true", help="no window; only print the results")
    play.add_argument("--record", metavar="FILE.npz", help="save the episodes (see flexarm_env.recording)")

    for name, summary in TRAINING.items():
        add(name, summary, "", "training")
    bench = add("bench", "evaluate policies on the suite, or run a benchmark", BENCH, "checkout", "")
    bench.usage = "%(prog)s [NAME [FLAGS]]"

    identify = add("identify", "fit an arm to measured logs", IDENTIFY, "identify", IDENTIFY_CODES)
    identify.add_argument("arm", metavar="ARM", help="initial guess: name or TOML file of an arm")
    identify.add_argument("--config", required=True, metavar="FILE", help="TOML file: columns, filters, parameters")
    identify.add_argument("--data", required=True, metavar="A.csv[,...]", help="logs that are fitted")
    identify.add_argument("--fit", metavar="NAME[,NAME...]", help="parameters to fit; default: those in the config")
    identify.add_argument("--hold-out", metavar="B.csv[,...]", help="logs for validation, which are not fitted")
    identify.add_argument("--out", metavar="FOLDER", help="folder for arm.toml, report.md and figures")

    excite = add("excite", "design torques that excite an arm, within bounds", EXCITE, "identify")
    excite.add_argument("arm", metavar="ARM", help="approximate model of the arm: name or TOML file")
    excite.add_argument("--out", required=True, metavar="FILE.csv", help="output file with columns t, torque0, ...")
    for flag, default, metavar, what in EXCITED:
        kind = float if default is None else type(default)
        excite.add_argument(flag, type=kind, default=default, metavar=metavar, help=what)

    serve = add("serve", "simulate an arm in real time, controlled over UDP", SERVE, "remote")
    serve.add_argument("what", metavar="ARM", help="environment id, task of the suite, or name or TOML file of an arm")
    serve.add_argument("--rate", type=float, default=100.0, metavar="HZ", help="control periods per second (100)")
    serve.add_argument("--host", default="127.0.0.1", metavar="ADDRESS", help="address to listen on (127.0.0.1)")
    serve.add_argument("--port", type=int, default=7070, metavar="N", help="port to listen on; 0: any free port (7070)")
    serve.add_argument("--key", metavar="FILE", help="file with a key, shared with the client, that signs every packet")
    serve.add_argument("--insecure", action="store_true", help="accept other machines without a key")
    serve.add_argument("--watchdog", type=int, default=5, metavar="N", help="periods without command until a hold (5)")
    serve.add_argument("--hold", choices=("zero", "angles"), default="zero", help="no torque (default), or PD control")
    serve.add_argument("--most-angle", type=float, metavar="RAD", help="joint angle beyond which the arm is held")
    serve.add_argument("--most-rate", type=float, metavar="RAD/S", help="joint rate beyond which the arm is held")
    serve.add_argument("--most-change", type=float, metavar="SHARE", help="torque change per period / torque limit")
    serve.add_argument("--env-kwargs", metavar="JSON", help="keywords of the environment")
    serve.add_argument("--seed", type=int, metavar="S", help="seed of the arm's initial state")
    serve.add_argument("--log", metavar="FILE.csv", help="write a row per period, for flexarm identify")
    serve.add_argument("--seconds", type=float, metavar="T", help="duration, s; default: until Ctrl-C")

    run = add("run", "control a served or real arm", RUN, "remote", RUN_CODES)
    run.add_argument("policy", metavar="POLICY", help="policy, as for flexarm play, or FILE.csv")
    run.add_argument("--to", required=True, metavar="HOST:PORT", help="address of the arm")
    run.add_argument("--key", metavar="FILE", help="file with the key shared with the server")
    run.add_argument("--env", metavar="ENV", help="environment that a controller uses as its model")
    run.add_argument("--env-kwargs", metavar="JSON", help="keywords of the environment")
    run.add_argument("--seconds", type=float, metavar="T", help="duration, s (10; or the duration of FILE.csv)")
    run.add_argument("--most-angle", type=float, metavar="RAD", help="joint angle beyond which the run ends")
    run.add_argument("--most-rate", type=float, metavar="RAD/S", help="joint rate beyond which the run ends")

    what = "export policies (ONNX, C), controllers (C, FMU), arms (C library, FMU, MJCF, URDF)"
    export = add("export", what, EXPORT, "export")
    what = "policy or controller; for library and fmu an environment id, a task or an arm; for mjcf and urdf an arm"
    export.add_argument("what", metavar="WHAT", help=what)
    export.add_argument("--to", required=True, choices=FORMS, help="output format")
    export.add_argument("--out", required=True, metavar="PATH", help="output file, or folder of a library")
    export.add_argument("--name", metavar="NAME", help="prefix of all names in C; default: derived from --out")
    export.add_argument("--fmi", choices=("2.0", "3.0"), help="FMI version; default 3.0")
    export.add_argument("--cpu", metavar="CPU", help="target processor: native or an LLVM name; default x86-64-v2")
    export.add_argument("--env", metavar="ENV", help="environment for which a controller is designed")
    export.add_argument("--env-kwargs", metavar="JSON", help="keywords of the environment")
    export.add_argument("--slew", type=float, metavar="RAD", help="for time_optimal: angle of the planned slew")
    export.add_argument("--elbows", metavar="LOW:HIGH[,...]", help="elbow angles for which gains are tabulated, rad")
    export.add_argument("--targets", metavar="X:Y:Z[,...]", help="in space: target points of the controller, m")
    export.add_argument("--segments", type=int, metavar="N", help="for mjcf: springs per flexible link (4)")
    export.add_argument("--placement", metavar="WHERE", help="for mjcf: gauss (points) or middle (of cells); (gauss)")
    export.add_argument("--gravity", metavar="X:Y:Z", help="for mjcf: m/s^2; default 0:0:0, in space 0:0:-9.81")

    import_ = add("import", "convert a robot's URDF or MJCF file to an arm", IMPORT, "exchange")
    import_.add_argument("file", metavar="FILE", help="robot.urdf or robot.xml")
    import_.add_argument("--out", required=True, metavar="ARM.toml", help="output file")
    import_.add_argument("--root", metavar="BODY", help="first body of the chain, if the file has several chains")
    import_.add_argument("--tip", metavar="NAME", help="body or site at the arm's tip")
    import_.add_argument("--flexible", action="append", metavar="BODY=SECTION", help="flexible link and its section")
    import_.add_argument("--tau-d", type=float, default=0.0, metavar="S", help="damping time of flexible links, s (0)")
    import_.add_argument("--gear-ratio", type=float, default=100.0, metavar="R", help="gear ratio of all motors (100)")

    compile_ = add("compile", "compile the programs for default settings in advance", COMPILE, "compile", "")
    compile_.add_argument("--all", action="store_true", help="all formulations, not only the defaults")
    compile_.add_argument("--clean", action="store_true", help="delete the cached code and compile nothing")

    schema = add("schema", "print the JSON schema of arm or scene files", SCHEMA, "schema", "")
    schema.add_argument("of", nargs="?", choices=("arm", "scene"), default="arm", help="kind of file (arm)")
    add("doctor", "print versions, threads and cache; run a self-test", DOCTOR, "doctor", "")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit code (SystemExit is raised for --help and wrong flags)."""
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

    before = warnings.formatwarning
    warnings.formatwarning = lambda message, *_: f"flexarm {args.command}: warning: {' '.join(str(message).split())}\n"
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
    finally:
        warnings.formatwarning = before
    return code
