"""Read Stable-Baselines3 models with NumPy alone, without executing their pickles.

A model.zip stores the network's arrays in `policy.pth`, a PyTorch archive. The archive consists of a pickle with names,
shapes and offsets, and of files with the numbers. The class `_Arrays` creates the arrays, and replaces every other
class in the pickle by a dummy, so that no code in the file is executed. A `vecnormalize.pkl` beside the model is also
read without executing its pickle.
"""

from __future__ import annotations

import io
import pickle
import re
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..files import from_json
from ..validation import Array32
from .policy import MOST_BYTES, NumpyPolicy, format_of, policy_from

STORAGES = {"FloatStorage": "<f4", "DoubleStorage": "<f8", "LongStorage": "<i8", "IntStorage": "<i4"}
"""NumPy types of PyTorch's storage classes."""
LSTM = re.compile(r"lstm_actor\.weight_ih_l(\d+)")
LAYERS = (
    (r"actor\.latent_pi\.(\d+)", "actor.mu", True),  # SAC, TQC
    (r"actor\.mu\.(\d+)", "", True),  # TD3, DDPG
    (r"mlp_extractor\.policy_net\.(\d+)", "action_net", False),  # PPO, A2C, TRPO
)
"""For each family of algorithms: names of the hidden layers, name of the last layer, and whether tanh squashes the
action."""


class _Anything:
    """Dummy for any class or function that a pickle names: accepts every argument and does nothing."""

    def __init__(self, *given: Any, **named: Any) -> None: ...

    def __setstate__(self, state: Any) -> None:
        """Store the attributes that the pickle contains."""
        for part in state if isinstance(state, tuple) else (state,):
            self.__dict__.update(part if isinstance(part, dict) else {})

    def __setitem__(self, key: Any, value: Any) -> None: ...

    def append(self, item: Any) -> None:
        """Discard an item that the pickle appends to a list."""

    extend = append


class _Dictionary(dict[str, Any]):
    """PyTorch's dictionary of arrays, which may carry attributes."""


class _Arrays(pickle.Unpickler):
    """Unpickler of arrays, dictionaries and numbers; everything else becomes `_Anything`."""

    def __init__(self, content: bytes, storage: Callable[[str, str], NDArray[Any]] | None = None) -> None:
        super().__init__(io.BytesIO(content))
        self.storage = storage

    def find_class(self, module: str, name: str) -> Any:
        """Return the class or function if it only builds arrays and is harmless, otherwise `_Anything`."""
        if (module, name) == ("collections", "OrderedDict"):
            return _Dictionary
        if module == "torch._utils" and name in ("_rebuild_tensor_v2", "_rebuild_parameter"):
            return _tensor if name == "_rebuild_tensor_v2" else lambda tensor, *rest: tensor
        if module == "torch" and name in STORAGES:
            return name
        if module == "numpy" and name in ("ndarray", "dtype"):
            return getattr(np, name)
        if module.startswith("numpy.") and module.endswith("core.multiarray") and name == "_reconstruct":
            return lambda kind, shape, letter: np.ndarray(0, "u1")
        if module.startswith("numpy.") and module.endswith("core.numeric") and name == "_frombuffer":
            return lambda buffer, dtype, shape, order: np.frombuffer(buffer, dtype).reshape(shape, order=order)
        return _Anything

    def persistent_load(self, pid: Any) -> Any:
        """Return the flat array in which a tensor is stored."""
        _, kind, key, *_ = pid
        if self.storage is None:
            raise pickle.UnpicklingError("no tensors belong there")
        return self.storage(str(kind), str(key))


def _tensor(flat: NDArray[Any], offset: int, shape: tuple[int, ...], stride: tuple[int, ...], *rest: Any) -> Any:
    """Return a tensor as a slice of its flat array.

    Only row-major tensors, such as those of all layers, are accepted.
    """
    count = int(np.prod(shape, dtype=np.int64))
    # strides of a row-major array
    rows = tuple(int(np.prod(shape[k + 1 :], dtype=np.int64)) for k in range(len(shape)))
    if any(one != other for one, other, size in zip(stride, rows, shape, strict=True) if size > 1):
        raise pickle.UnpicklingError("a tensor that does not lie row by row")
    return flat[offset : offset + count].reshape(shape)


def _opened(content: bytes | Path) -> zipfile.ZipFile:
    """Open a zip archive; raise ValueError if it unpacks to more than `MOST_BYTES`."""
    archive = zipfile.ZipFile(io.BytesIO(content) if isinstance(content, bytes) else content)
    if sum(info.file_size for info in archive.infolist()) > MOST_BYTES:
        raise ValueError(f"unpacks to more than {MOST_BYTES} bytes")
    return archive


def _state(content: bytes) -> dict[str, NDArray[Any]]:
    """Read the arrays of a PyTorch archive by name."""
    archive = _opened(content)
    (home,) = [name.removesuffix("data.pkl") for name in archive.namelist() if name.endswith("/data.pkl")]

    def storage(kind: str, key: str) -> NDArray[Any]:
        return np.frombuffer(archive.read(f"{home}data/{key}"), STORAGES[kind])

    # tensors refer to their storages by key
    found = _Arrays(archive.read(f"{home}data.pkl"), storage).load()
    return {str(name): value for name, value in found.items() if isinstance(value, np.ndarray)}


def load_model(path: Path, meta: Mapping[str, Any]) -> NumpyPolicy:
    """Load the deterministic policy in a model.zip of PPO, A2C, SAC, TD3, TQC or RecurrentPPO.

    Args:
        path: path of the model.zip. If the same folder contains a `vecnormalize.pkl`, the policy normalizes
            observations with its statistics.
        meta: training record (env_id, env_kwargs and layout), or {}.
    Raises:
        ValueError: the file is damaged, or it is not a model of these algorithms with a supported network.
    """
    # a damaged archive can fail in many ways
    try:
        archive = _opened(path)
        about = from_json(archive.read("data").decode(), "data")
        state = _state(archive.read("policy.pth"))
    except Exception as error:  # a damaged archive fails in many ways
        raise ValueError(f"{path}: no model of Stable-Baselines3 that can be read ({type(error).__name__})") from None
    with check.in_file(path):
        return _network(state, check.table_of("data", about), meta, _normaliser(path.with_name("vecnormalize.pkl")))


def _network(
    state: dict[str, NDArray[Any]], about: dict[str, Any], meta: Mapping[str, Any], normaliser: dict[str, Any] | None
) -> NumpyPolicy:
    """Build the policy from arrays with PyTorch's names.

    about: the model's parameters. meta: record of the training. normaliser: VecNormalize statistics or None.
    """
    names, squash = [], False
    for hidden, last, squashed in LAYERS:
        matches = (re.fullmatch(rf"{hidden}\.weight", name) for name in state)
        places = sorted((int(found[1]), found[0].removesuffix(".weight")) for found in matches if found)
        if places or f"{last}.weight" in state:
            names, squash = [*(name for _, name in places), *([last] if last else [])], squashed
            break
    else:
        raise ValueError("its network is none of PPO, A2C, SAC, TD3, TQC or RecurrentPPO with a plain policy")
    if any(name.startswith("features_extractor.") or ".features_extractor." in name for name in state):
        raise ValueError("its network has a features extractor of its own, which is not read")
    # the library's default activation differs between families
    chosen = about.get("policy_kwargs")
    chosen = chosen if isinstance(chosen, dict) else {}
    usual = "relu" if squash else "tanh"
    kind = re.search(r"\.(\w+)'>", str(chosen.get("activation_fn", f".{usual}'>")))
    activation = kind[1].lower() if kind else ""
    arrays: dict[str, Any] = {}
    for k, name in enumerate(names):
        arrays |= {f"w{k}": state[f"{name}.weight"].T, f"b{k}": state[f"{name}.bias"]}
    own = {"format": format_of(meta), "layers": len(names), "activation": activation, "squash": squash}
    cells = len([name for name in state if LSTM.fullmatch(name)])
    if not cells:
        return policy_from({**meta, **own}, arrays | (normaliser or {}), bound=bool(meta))
    plain = policy_from({**meta, **own}, arrays, bound=bool(meta))
    parts = ("weight_ih", "weight_hh", "bias_ih", "bias_hh")
    # LSTM layers: input and hidden weights, and their biases
    memory = [[state[f"lstm_actor.{part}_l{k}"].astype(np.float64) for part in parts] for k in range(cells)]
    width, entries = memory[0][1].shape[1], memory[0][0].shape[1]
    # validate shapes: the four gates are stacked in the rows
    for k, own_arrays in enumerate(memory):
        shapes = ((4 * width, width if k else entries), (4 * width, width), (4 * width,), (4 * width,))
        for part, one, shape in zip(parts, own_arrays, shapes, strict=True):
            check.array(f"lstm_actor.{part}_l{k}", one, shape)
    for name in ("mean", "variance"):
        check.array(name, (normaliser or {}).get(name, np.zeros(entries)), (entries,))
    return RecurrentPolicy(plain, memory, normaliser)


def _normaliser(path: Path) -> dict[str, Any] | None:
    """Read mean, variance, clip and epsilon of a VecNormalize file; None without a file or with norm_obs off."""
    if not path.is_file():
        return None
    try:
        if path.stat().st_size > MOST_BYTES:
            raise ValueError("too large")
        found = vars(_Arrays(path.read_bytes()).load())
        if not found["norm_obs"]:
            return None
        moments = vars(found["obs_rms"])
        mean, variance = (np.array(moments[name], np.float64) for name in ("mean", "var"))
        clip, epsilon = np.float64(found["clip_obs"]), np.float64(found["epsilon"])
    except Exception as error:
        raise ValueError(f"{path}: no statistics of VecNormalize that can be read ({type(error).__name__})") from None
    return {"mean": mean, "variance": variance, "clip": clip, "epsilon": epsilon}


class RecurrentPolicy(NumpyPolicy):
    """Policy with LSTM layers before its network (RecurrentPPO)."""

    def __init__(
        self, plain: NumpyPolicy, memory: list[list[NDArray[Any]]], normaliser: Mapping[str, Any] | None
    ) -> None:
        """Store the network `plain`, the LSTM layers' weights and biases, and the observation statistics."""
        super().__init__(plain.meta, plain.weights, normaliser)
        self.memory = memory
        self.state: list[tuple[NDArray[Any], NDArray[Any]]] | None = None

    @property
    def size(self) -> int:
        """Number of entries of an observation."""
        return int(self.memory[0][0].shape[1])

    def reset(self, observation: NDArray[np.floating]) -> None:
        """Clear the memory of the LSTM layers."""
        self.state = None

    def act(self, observation: NDArray[np.floating]) -> Array32:
        """Compute actions (n, N) in [-1, 1] from the observation and the LSTM memory, which `reset` clears."""
        x = self._seen(observation)
        width = self.memory[0][1].shape[1]
        if self.state is None or self.state[0][0].shape[:-1] != x.shape[:-1]:
            zero = np.zeros((*x.shape[:-1], width))
            self.state = [(zero, zero) for _ in self.memory]
        for k, (of_input, of_hidden, *biases) in enumerate(self.memory):
            hidden, cell = self.state[k]
            # gates i, f, g, o (Hochreiter & Schmidhuber 1997): c = f c + i g, h = o tanh(c)
            i, f, g, o = np.split(x @ of_input.T + hidden @ of_hidden.T + sum(biases), 4, axis=-1)
            cell = _logistic(f) * cell + _logistic(i) * np.tanh(g)
            x = _logistic(o) * np.tanh(cell)
            self.state[k] = (x, cell)
        return self._decided(x)


def _logistic(x: NDArray[Any]) -> NDArray[Any]:
    """Return the logistic function 1 / (1 + exp(-x)), in a form without overflow."""
    return 0.5 * (1.0 + np.tanh(0.5 * x))
