"""An arm that a C library moves, called from Python."""

import ctypes
from typing import Any

import numpy as np

from flexarm_env.library import Built


class Arm:
    """A library's arm."""

    def __init__(self, built: Built) -> None:
        assert built.library is not None
        self.name, self._code = built.name, ctypes.CDLL(str(built.folder / built.library))
        self._known("create").restype = ctypes.c_void_p
        for word in ("get_info", "get_poses", "get_observation"):
            self._known(word).restype = ctypes.c_void_p
        for word in ("get_reward", "get_time"):
            self._known(word).restype = ctypes.c_double
        self._known("status").restype = ctypes.c_char_p
        self.at = ctypes.c_void_p(self._known("create")())
        assert self.at.value

    def _known(self, word: str) -> Any:
        return getattr(self._code, f"{self.name}_{word}")

    def __call__(self, word: str, *items: Any) -> Any:
        given = [item.ctypes.data_as(ctypes.c_void_p) if isinstance(item, np.ndarray) else item for item in items]
        return self._known(word)(self.at, *given)

    def reset(self, key: int, vibration: float = np.nan) -> int:
        return int(self("reset", ctypes.c_uint64(key), None, None, ctypes.c_double(vibration)))

    def seeded(self, seed: int) -> int:
        """Reset as Gymnasium seeds an environment."""
        return self.reset(int(np.random.PCG64(np.random.SeedSequence(seed)).random_raw()))

    def row(self, word: str, count: int, kind: str = "d") -> np.ndarray[Any, Any]:
        number = {"d": ctypes.c_double, "f": ctypes.c_float}[kind]
        return np.ctypeslib.as_array(ctypes.cast(self(word), ctypes.POINTER(number)), (count,)).copy()

    def status(self, code: int) -> str:
        return str(self._known("status")(code).decode())

    def destroy(self) -> None:
        self("destroy")
