"""`flexarm export`: write a trained policy as ONNX or C, a controller as C or FMU, or an arm as a C library or FMU."""

import argparse
from pathlib import Path
from typing import Any

import gymnasium as gym

from flexarm_env import arms, suite
from flexarm_env import validation as check
from flexarm_env.cli import exchange
from flexarm_env.cli.arm import environment_of
from flexarm_env.cli.codes import DONE
from flexarm_env.cli.exchange_texts import FORMS
from flexarm_env.cli.play import keywords
from flexarm_env.cli.progress import show
from flexarm_env.control import NAMES, NumpyPolicy, Setup, find_policy, make, policy_names
from flexarm_env.control.export import Entries, c_name, c_source, onnx_bytes
from flexarm_env.control.export_around import around_c_source, onnx_law
from flexarm_env.control.in_c import controller_source
from flexarm_env.control.policy import AroundPolicy
from flexarm_env.envs.ids import own_ids, permitted
from flexarm_env.files import write_whole
from flexarm_env.library import write, write_controller_fmu, write_fmu


def run(args: argparse.Namespace) -> int:
    """Write the exported file or folder, and print its contents; return the exit code."""
    if not args.out.strip():
        raise check.InvalidValue("--out", args.out, "must be a path")
    out = Path(args.out)
    if args.fmi is not None and args.to != "fmu":
        raise check.InvalidValue("--fmi", args.fmi, "requires --to fmu")
    if args.to != "library" and out.suffix.lower() != FORMS[args.to]:
        raise check.InvalidValue("--out", args.out, f"must end in {FORMS[args.to]} for --to {args.to}")
    if args.to in ("mjcf", "urdf"):
        return exchange.export(args, out)
    for flag in exchange.FLAGS:
        if getattr(args, flag) is not None:
            raise check.InvalidValue(f"--{flag}", getattr(args, flag), "must not be given but with --to mjcf")
    if args.to in ("library", "fmu") and args.what not in NAMES:
        return _arm(args, out)
    for flag, value in (("--name", None if args.to == "fmu" else args.name), ("--cpu", args.cpu)):
        if value is not None:
            raise check.InvalidValue(flag, value, "requires --to library or fmu")
    if args.what in NAMES:
        return _controller(args, out)
    if Path(args.what).suffix == ".toml" or (args.what in _arms() and args.what not in policy_names()):
        what = "must be a policy or a controller; export an arm with --to library or fmu"
        raise check.InvalidValue("WHAT", args.what, what)
    policy = find_policy(args.what, "WHAT").policy
    inside = isinstance(policy, AroundPolicy)
    for word in ("env", "slew", "env_kwargs", *(() if inside else ("elbows", "targets"))):
        value = getattr(args, word)
        if value is not None:
            flag = f"--{word.replace('_', '-')}"
            raise check.InvalidValue(flag, value, "must not be given for a policy, which defines its own environment")
    if type(policy) not in (NumpyPolicy, AroundPolicy):
        what = "must be a feedforward network: a run folder, a policy.npz, a model.zip or a policy of the package"
        raise check.InvalidValue("WHAT", args.what, what)
    size, joints = policy.weights[0][0].shape[0], policy.weights[-1][0].shape[1]
    values = {"export": str(out), "observation": size, "actions": joints}
    if inside:
        content, own = _around(args, policy, out)
        values |= own
    elif args.to == "onnx":
        content = onnx_bytes(policy)
    else:
        name = c_name(out.stem)
        content = c_source(policy, entries_of(policy, args.what), name).encode()
        values["function"] = f"{name}_decide"
    write_whole(out, content)
    show(values | {"bytes": len(content)}, args.json)
    return DONE


def _around(args: argparse.Namespace, policy: AroundPolicy, out: Path) -> tuple[bytes, dict[str, Any]]:
    """Return the exported file of a policy with a controller inside, and the lines to print about it."""
    env_id, kwargs = permitted(args.what, policy.meta["env_id"], policy.meta["env_kwargs"])
    env = gym.make(env_id, **kwargs)
    bound: Any = policy.bound(env)
    env.close()
    if args.to == "onnx":
        return onnx_bytes(bound, (policy.inside.share, onnx_law(bound))), {}
    elbows = _rows("--elbows", args.elbows, 2, "LOW:HIGH,... in rad, one pair per elbow")
    targets = _rows("--targets", args.targets, 3, "X:Y:Z,... in m, one point per target")
    name = c_name(out.stem)
    source = around_c_source(bound, entries_of(policy, args.what), name, elbows, targets)
    return source.encode(), {"function": f"{name}_decide"}


def _controller(args: argparse.Namespace, out: Path) -> int:
    """Export a controller as C source or as an FMU, depending on the flags; return the exit code."""
    if args.to not in ("c", "fmu"):
        raise check.InvalidValue("--to", args.to, "must be c or fmu for a controller")
    if args.env is None:
        raise check.InvalidValue("--env", args.env, "is required: a controller is designed for an environment")
    if args.slew is not None and args.what != "time_optimal":
        raise check.InvalidValue("--slew", args.slew, "requires the controller time_optimal")
    if args.slew is None and args.what == "time_optimal":
        raise check.MissingKey("--slew", "time_optimal plans slews by one angle, rad, to either side: --slew 1.57")
    env = environment(args.env, keywords(args.env_kwargs))
    name, own = args.name or c_name(out.stem), make(args.what, env)
    elbows = _rows("--elbows", args.elbows, 2, "LOW:HIGH,... in rad, one pair per elbow")
    targets = _rows("--targets", args.targets, 3, "X:Y:Z,... in m, one point per target")
    env.close()
    if args.to == "fmu":
        write_controller_fmu(own, out, name, args.fmi or "3.0", args.slew, elbows, targets)
        show({"export": str(out), "bytes": out.stat().st_size}, args.json)
        return DONE
    content = controller_source(own, name, args.slew, elbows, targets).encode()
    write_whole(out, content)
    show({"export": str(out), "function": f"{name}_decide", "bytes": len(content)}, args.json)
    return DONE


def _rows(flag: str, text: str | None, count: int, what: str) -> Any:
    """Parse LOW:HIGH,LOW:HIGH,... or X:Y:Z,... to rows of `count` numbers; return None without a text."""
    try:
        rows = [tuple(map(float, row.split(":"))) for row in ([] if text is None else text.split(","))]
    except ValueError:
        rows = [()]
    if any(len(row) != count for row in rows):
        raise check.InvalidValue(flag, text, f"must be {what}")
    return rows or None


def _arm(args: argparse.Namespace, out: Path) -> int:
    """Export an environment's arm as a C library or FMU, depending on the flags; return the exit code."""
    fmu = args.to == "fmu"
    env = environment(args.what, keywords(args.env_kwargs))
    name = args.name if args.name is not None else c_name(out.resolve().stem if fmu else out.resolve().name)
    if fmu:
        write_fmu(env, out, name, args.fmi or "3.0", args.cpu)
        values: dict[str, Any] = {"export": str(out), "bytes": out.stat().st_size}
    else:
        built = write(env, out, name, args.cpu)
        values = {"export": str(out), "library": built.library, "header": f"{name}.h"}
        values |= ({"why": built.why} if built.why else {}) | {"files": list(built.files)}
    env.close()
    show(values, args.json)
    return DONE


def _arms() -> tuple[str, ...]:
    """Return the list of words that the function `environment` accepts."""
    return (*own_ids(), *(task.id for task in suite.tasks(earlier=True)), *arms.names())


def environment(word: str, options: dict[str, Any]) -> Any:
    """Create the environment that a word names: an environment's id, a task of the suite, or an arm (name or file)."""
    known = [task.id for task in suite.tasks(earlier=True)]
    if word in known:
        return suite.make(word, **options)
    if word.removeprefix("flexarm_env:") in own_ids():
        return gym.make(word, **options)
    if word in arms.names() or Path(word).suffix == ".toml":
        return gym.make(environment_of(arms.resolve(word)), arm=word, **options)
    raise check.UnknownKey(word, _arms(), "environment, task, arm or TOML file")


def entries_of(policy: NumpyPolicy, word: str) -> Entries:
    """Return the observation's entries from the policy's file or, if the file lacks them, from its environment."""
    known = Entries.of(policy)
    if known is not None:
        return known
    env_id, kwargs = permitted(word, policy.meta["env_id"], policy.meta["env_kwargs"])
    env = gym.make(env_id, **kwargs)
    setup = Setup.of(env)
    policy.check(setup)
    plain = kwargs.get("action_mode", "torque") == "torque"
    env.close()
    return Entries(setup.names, setup.scales, setup.torque_limits if plain else ())
