"""`flexarm export`: a trained policy as ONNX or as C."""

from __future__ import annotations

import argparse
from pathlib import Path

import gymnasium as gym

from flexarm_env import validation as check
from flexarm_env.cli.codes import DONE
from flexarm_env.cli.progress import show
from flexarm_env.control import NumpyPolicy, Setup, load_policy
from flexarm_env.control.export import Entries, c_name, c_source, onnx_bytes
from flexarm_env.envs.ids import permitted
from flexarm_env.files import write_whole

FORMS = {"onnx": ".onnx", "c": ".c"}
"""What --to takes, and how such a file's name ends."""


def run(args: argparse.Namespace) -> int:
    """Write the file and say what is in it."""
    out = Path(args.out)
    if out.suffix.lower() != FORMS[args.to]:
        raise check.InvalidValue("--out", args.out, f"must end in {FORMS[args.to]} for --to {args.to}")
    policy = load_policy(args.policy)
    size, joints = policy.weights[0][0].shape[0], policy.weights[-1][0].shape[1]
    values = {"export": str(out), "observation": size, "actions": joints}
    if args.to == "onnx":
        content = onnx_bytes(policy)
    else:
        name = c_name(out.stem)
        content = c_source(policy, entries_of(policy, args.policy), name).encode()
        values["function"] = f"{name}_decide"
    write_whole(out, content)
    show(values | {"bytes": len(content)}, args.json)
    return DONE


def entries_of(policy: NumpyPolicy, word: str) -> Entries:
    """What the policy's file says of its entries, or else its environment, which is made for it."""
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
