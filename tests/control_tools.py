"""What the tests of controllers share."""

from typing import Any

import numpy as np

from flexarm_env import control
from tests.refusals import refusal


def assert_restart_is_a_start(name: str, env: Any) -> None:
    """Assert that a restarted arm is steered as at a start, and the other two arms of env as before."""
    own, fresh = control.make(name, env), control.make(name, env)
    first, _ = env.reset(seed=3)
    own.reset(first)
    seen = first
    for _ in range(8):
        seen, *_ = env.step(own.act(seen))
    mask = np.array([False, True, False])
    unchanged, mixed = control.make(name, env), np.where(mask[:, None], first, seen)
    unchanged.__dict__.update({k: v.copy() if isinstance(v, np.ndarray) else v for k, v in vars(own).items()})
    own.restart(mixed, mask)
    fresh.reset(first)
    found = own.act(mixed)
    assert np.array_equal(found[1], fresh.act(first)[1])
    assert np.array_equal(found[[0, 2]], unchanged.act(seen)[[0, 2]])
    refusal(lambda: own.act(seen[:2]))
