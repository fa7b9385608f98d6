"""Export trained policies as a C file, for example for a microcontroller, or as an ONNX model.

C file and ONNX model contain the numbers of a `policy.npz`; their actions differ from those of :class:`NumpyPolicy` by
at most 1e-6. The ONNX model computes sums in double precision, as `NumpyPolicy` does. The C file computes sums in
float32 with compensation (Dekker 1971).
"""

from __future__ import annotations

import json
import keyword
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..tasks.program import CLIP
from .policy import NumpyPolicy

FAR = 1e9
"""Magnitude to which a policy in C clips an observation's entries; it is well within float32's range."""
OPSET, IR_VERSION = 17, 8
"""ONNX versions, chosen old enough for current runtimes."""


@dataclass(frozen=True)
class Entries:
    """Observation entries of a policy: names and scales at one instant, in order (entry = value / scale).

    torque_limits: torque of each joint at an action of 1, N m; empty if actions are not torques.
    """

    names: tuple[str, ...]
    scales: tuple[float, ...]
    torque_limits: tuple[float, ...] = ()

    @classmethod
    def of(cls, policy: NumpyPolicy) -> Entries | None:
        """Read the entries from the policy's metadata; None for files of version 0.1, which lack the entries."""
        scales = policy.meta.get("scales")
        if not scales:
            return None
        plain = policy.meta["env_kwargs"].get("action_mode", "torque") == "torque"
        return cls(tuple(scales), tuple(scales.values()), tuple(policy.meta.get("torque_limits", ())) if plain else ())


# ------------------------------------------------------------------ ONNX
def onnx_bytes(policy: NumpyPolicy, law: tuple[float, NDArray[np.float64]] | None = None) -> bytes:
    """Serialize the policy as an ONNX model from `observation` (n, entries) to `action` (n, joints), both float32.

    The input is the environment's observation, including previous instants; the model normalizes it. Actions are in
    [-1, 1]. The model's metadata is the policy's `meta`. law: for a policy with a controller inside, the factor on the
    network's actions, and a matrix K. The unsaturated actions of the controller are observation @ K. Raises ImportError
    if the package onnx is missing.
    """
    with check.needs("an ONNX file", "onnx", "export"):
        from onnx import TensorProto, checker, helper, numpy_helper
    if law is None and "around" in policy.meta:
        raise check.InvalidValue("law", law, "must be given for a policy with a controller inside")
    constants: dict[str, NDArray[np.float64]] = {}
    nodes: list[Any] = []
    last = "observation"

    def then(operator: str, *given: tuple[str, Any], **attributes: Any) -> None:
        """Append a node that takes the last output and the given named constants."""
        nonlocal last
        constants.update({name: np.asarray(value, np.float64) for name, value in given})
        before, last = last, f"x{len(nodes)}"
        nodes.append(helper.make_node(operator, [before, *(name for name, _ in given)], [last], **attributes))

    then("Cast", to=TensorProto.DOUBLE)
    if policy.normaliser is not None:
        n = policy.normaliser
        then("Sub", ("mean", n["mean"]))
        then("Div", ("deviation", np.sqrt(n["variance"] + n["epsilon"])))
        then("Clip", ("least", -n["clip"]), ("most", n["clip"]))
    layers = len(policy.weights)
    for k, (w, b) in enumerate(policy.weights):
        then("MatMul", (f"w{k}", w))
        then("Add", (f"b{k}", b))
        if k < layers - 1:
            then("Tanh" if policy.meta["activation"] == "tanh" else "Relu")
    if policy.meta["squash"]:
        then("Tanh")
    else:
        then("Clip", ("down", -1.0), ("up", 1.0))
    if law is not None:
        # clip(observation @ K + share * network); x0 is the observation in double precision
        then("Mul", ("share", law[0]))
        constants["K"] = np.asarray(law[1], np.float64)
        nodes.append(helper.make_node("MatMul", ["x0", "K"], ["inside"]))
        nodes.append(helper.make_node("Add", [last, "inside"], ["total"]))
        last = "total"
        then("Clip", ("lowest", -1.0), ("highest", 1.0))
    nodes.append(helper.make_node("Cast", [last], ["action"], to=TensorProto.FLOAT))
    size, joints = policy.weights[0][0].shape[0], policy.weights[-1][0].shape[1]
    graph = helper.make_graph(
        nodes, "policy",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["n", size])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, ["n", joints])],
        [numpy_helper.from_array(value, name) for name, value in constants.items()],
    )  # fmt: skip
    model = helper.make_model(
        graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION, producer_name="flexarm_env",
    )  # fmt: skip
    helper.set_model_props(model, {"flexarm_env": json.dumps(policy.meta)})
    checker.check_model(model)
    content: bytes = model.SerializeToString()
    return content


# ------------------------------------------------------------------ C
def check_name(name: str) -> str:
    """Validate a C identifier; raise ValueError for any other name."""
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z_]\w{0,59}", name, flags=re.ASCII):
        raise check.InvalidValue("name", name, "must be a C identifier: letters, digits, _, at most 60")
    return name


def c_name(word: str) -> str:
    """Convert a file's name to a C identifier."""
    name = re.sub(r"\W", "_", word, flags=re.ASCII)
    return f"_{name}" if name[:1].isdigit() or keyword.iskeyword(name) else name or "policy"


def c_part(part: str) -> str:
    """Read a fragment of C source text from `data/control/c`."""
    return (resources.files("flexarm_env") / "data" / "control" / "c" / f"{part}.c").read_text("utf-8")


def c_named(text: str, name: str) -> str:
    """Replace NAME by a name, and UPPER by the name in capitals, in C source text."""
    check_name(name)
    return re.sub("NAME|UPPER", lambda word: name if word[0] == "NAME" else name.upper(), text)


def c_comment(lines: Iterable[str]) -> str:
    """Format lines as a C comment; change character sequences that could end the comment."""
    return "\n".join(["/*", *(f" * {harmless(line)}".rstrip() for line in lines), " */"])


def harmless(line: str) -> str:
    """Return a line of user text in a form that is safe inside a C comment.

    Comment delimiters are separated by spaces. Backslashes and characters that are not printable ASCII become "?".
    Adjacent question marks are separated, too, because "??" begins C99's trigraph for a backslash.
    """
    # printable ASCII without backslash
    line = re.sub(r"[^ -\[\]-~]", "?", line)
    line = re.sub(r"\?(?=\?)", "? ", line)
    return re.sub(r"\*(?=/)", "* ", re.sub(r"/(?=\*)", "/ ", line))


def c_array(kind: str, name: str, words: Sequence[str], across: int) -> str:
    """Format the declaration of a constant array with `across` numbers per line."""
    rows = ",\n    ".join(", ".join(words[i : i + across]) for i in range(0, len(words), across))
    return f"static const {kind} NAME_{name}[{max(1, len(words))}] = {{\n    {rows or '0'}\n}};"


def c_source(policy: NumpyPolicy, entries: Entries, name: str) -> str:
    """Generate the policy as one C99 file without `main`, in float32 and with arrays of fixed size.

    Args:
        entries: entries of one instant. If the policy's observation contains several instants, the C code stores them.
        name: prefix of the file's definitions. NAME_decide maps the environment's observation to actions. NAME_act maps
            the values of one instant in SI units to actions. Other definitions are NAME_reset, NAME_memory and
            NAME_OBSERVATION.
    Raises:
        ValueError: the size of the policy's observation is not a multiple of the number of entries.
    """
    size, joints = policy.weights[0][0].shape[0], policy.weights[-1][0].shape[1]
    count, widths = len(entries.names), [w.shape[1] for w, _ in policy.weights]
    if count == 0 or size % count:
        raise check.InvalidValue("entries", count, f"must be a divisor of {size}, which the policy observes")
    declared = {
        "ENTRIES": count, "HISTORY": size // count, "OBSERVATION": size, "ACTIONS": joints, "WIDTH": max(size, *widths),
        "MOST": _number(CLIP), "FAR": _number(FAR),
    }  # fmt: skip
    text = "\n".join([
        _head(policy, entries, size // count),
        "#include <math.h>", "",
        *(f"#define UPPER_{word} {value}" for word, value in declared.items()), "",
        *_arrays(policy, entries),
        *map(c_part, ("policy_memory", "policy_bounded", "policy_layer")),
        *([c_part("policy_normal")] if policy.normaliser is not None else []),
        c_part("policy_decide").replace("STEPS", "\n".join(f"    {line}" for line in _steps(policy))),
        c_part("policy_act"),
    ])  # fmt: skip
    return c_named(text, name)


def _steps(policy: NumpyPolicy) -> Iterator[str]:
    """Generate the C statements from the observation to the actions; the layers write to `y` and `x` in turn."""
    # observation into x, clipped or normalized, with the remainder in x_rest
    if policy.normaliser is None:
        yield "for (i = 0; i < UPPER_OBSERVATION; i++)"
        yield "    x[i] = NAME_bounded(observation[i], UPPER_FAR), x_rest[i] = 0.0f;"
    else:
        yield "for (i = 0; i < UPPER_OBSERVATION; i++) x[i] = NAME_normal(i, observation[i], &x_rest[i]);"
    here, there = "x", "y"
    tanh = policy.meta["activation"] == "tanh"
    # activation; each value is carried as a float32 and its remainder
    law = "{0} = tanhf({0} + {1}), {1} = 0.0f" if tanh else "if ({0} + {1} < 0.0f) {0} = {1} = 0.0f"
    # layers from one buffer to the other
    for k, (w, _) in enumerate(policy.weights):
        rows, columns = w.shape
        yield f"NAME_layer({here}, {here}_rest, {rows}, NAME_w{k}, NAME_b{k}, {there}, {there}_rest, {columns});"
        if k < len(policy.weights) - 1:
            yield f"for (i = 0; i < {columns}; i++) {law.format(f'{there}[i]', f'{there}_rest[i]')};"
        here, there = there, here
    yield "for (i = 0; i < UPPER_ACTIONS; i++) {"
    yield f"    const float a = {here}[i] + {here}_rest[i];"
    yield f"    action[i] = {'tanhf(a)' if policy.meta['squash'] else 'a < -1.0f ? -1.0f : a > 1.0f ? 1.0f : a'};"
    yield "}"


def _head(policy: NumpyPolicy, entries: Entries, history: int) -> str:
    """Generate the comment at the top of a policy's C file."""
    meta = policy.meta
    joints = policy.weights[-1][0].shape[1]
    kwargs = json.dumps(meta["env_kwargs"]) if meta["env_kwargs"] else ""
    limits = ", ".join(f"{limit:g}" for limit in entries.torque_limits)
    mode = meta["env_kwargs"].get("action_mode", "torque")
    means = f"the joints' torques over {limits} N m" if limits else f'what the environment takes, action_mode "{mode}"'
    of_one = zip(entries.names, entries.scales, strict=True)
    units = [f"    {k}: {one} / {scale:.9g}" for k, (one, scale) in enumerate(of_one)]
    lines = [
        f"NAME: a policy trained on {meta['env_id']} {kwargs}",
        "written by flexarm_env. C99, float32, no allocation, no state but what the caller holds.",
        "",
        f"  void NAME_decide(const float observation[UPPER_OBSERVATION], float action[{joints}])",
        f"      the environment's observation ({history} x {len(entries.names)}, the newest instant last) to actions",
        "      (0 where a number is NaN)",
        "  void NAME_reset(NAME_memory *memory)",
        "      before an episode",
        f"  void NAME_act(NAME_memory *memory, const float measured[{len(entries.names)}], float action[{joints}])",
        "      what is measured now, in SI units, to actions: scaled, clipped"
        + (f", beside the {history - 1} instants before; once a control period" if history > 1 else ""),
        "      (actions 0 where a number is not finite; that instant is left out)",
        "",
        f"Actions lie in [-1, 1]: {means}.",
        f"Entries of an instant, value / scale, clipped at {CLIP:g}:",
        *units,
        "",
        "Every sum is carried with what float32 rounds off it (Dekker 1971): compile without -ffast-math.",
    ]
    return c_comment(lines)


def _arrays(policy: NumpyPolicy, entries: Entries) -> Iterator[str]:
    """Generate the declarations of all constants: scales, normalization statistics, weights and biases."""
    yield _array("scale", entries.scales)
    if policy.normaliser is not None:
        n = policy.normaliser
        for word, values in (("mean", n["mean"]), ("inverse", 1.0 / np.sqrt(n["variance"] + n["epsilon"]))):
            # float32 value and its remainder
            first = values.astype(np.float32)
            yield _array(word, first)
            yield _array(f"{word}_rest", values - first)
        yield f"static const float NAME_clip = {_number(n['clip'])};\n"
    for k, (w, b) in enumerate(policy.weights):
        yield _array(f"w{k}", w.ravel())
        yield _array(f"b{k}", b)


def _array(name: str, values: Sequence[float] | NDArray[Any]) -> str:
    """Format a float32 array's declaration, eight numbers per line."""
    return c_array("float", name, [_number(value) for value in values], 8) + "\n"


def _number(value: Any) -> str:
    """Format a number as an exact C float32 literal."""
    text = f"{np.float32(value):.9g}"
    return f"{text}f" if "." in text or "e" in text else f"{text}.0f"
