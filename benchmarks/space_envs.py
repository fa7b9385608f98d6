"""Measure accuracy and speed of `SpatialFlexArm-v0` by random torques and PD: docs/environments/spatial_results.md."""

import argparse
import dataclasses
import sys
import time
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from benchmarks import pages
from benchmarks.machine import table
from benchmarks.running import periods
from flexarm_env import arms, control

ID = "SpatialFlexArm-v0"
REFERENCE: dict[str, Any] = {"elements": 6, "dt": 1.25e-4, "tolerance": 1e-9}
FINE = {"dt": 1e-3, "tolerance": 1e-7}
CANDIDATES: tuple[dict[str, Any], ...] = (
    {"elements": 2, "dt": 2.5e-3}, {"elements": 2, **FINE}, {"elements": 4, **FINE},
    {"elements": 6, "dt": 2.5e-4, "tolerance": 1e-9},
)  # fmt: skip
FRAMES: tuple[dict[str, Any], ...] = (
    {"modes": 2, "dt": 5e-3, "tolerance": 5e-6, "rho_inf": 0.5}, {"modes": 3, "dt": 2.5e-3},
    {"segments": 2, "dt": 2.5e-3},
)  # fmt: skip
"""Settings with floating frames, run under a quarter of the torque limits; the first one is also timed.

The timed setting has rho_inf = 0.5. With the default 0.9, high frequencies that the step does not resolve persist, and
a step needs 1.4 times the iterations.
"""
COARSE: tuple[dict[str, Any], ...] = ({"elements": 1, "dt": 2.5e-3}, {"elements": 1, "dt": 1 / 300, "tolerance": 7e-6})
"""Settings with one element per link, run under a quarter of the torque limits.

At longer steps with the default tolerance of 1e-5 the solver reduces the tolerance, because errors of the weak motors'
torques would be too large (docs: theory, section 6).
"""
KEPT: tuple[dict[str, Any], ...] = (*CANDIDATES[:3], {"elements": 2, "dt": 5e-4, "tolerance": 1e-7})
TIMES = (10, 20, 30, 50)
"""Numbers of control periods after which errors are compared."""
ENERGIES = ("energy_kinetic", "energy_strain", "energy_gravity", "energy_dissipated")


def tips(share: float, episodes: int, **settings: Any) -> NDArray[np.float64]:
    """Return tip positions (periods, episodes, 3), m, under random torques that change in each control period."""
    env = gym.make_vec(ID, num_envs=episodes, **settings)
    env.reset(seed=1)
    rng, found = np.random.default_rng(5), []
    for _ in range(TIMES[-1]):
        action = share * rng.uniform(-1.0, 1.0, env.action_space.shape)
        found.append(env.step(action.astype(np.float32))[-1]["tip_position"].copy())
    return np.array(found)


def books(who: str, count: int = 100, **settings: Any) -> float:
    """Return the largest error of the energy balance over the exchanged work: the median of eight episodes.

    who: "pd", or "full": torques at their limits with random signs in each period.
    """
    env: Any = gym.make(ID, info_level="full", **settings)
    rng, found = np.random.default_rng(5), []
    for seed in range(8):
        observation, info = env.reset(seed=seed)
        controller = control.make("pd", env) if who == "pd" else None
        if controller is not None:
            controller.reset(observation)
        begun, work, turned, worst = sum(info[name] for name in ENERGIES), 0.0, 0.0, 0.0
        for _ in range(count):
            action = rng.choice([-1.0, 1.0], 3) if controller is None else controller.act(observation)
            observation, *_, info = env.step(np.asarray(action, np.float32))
            turned, work = turned + abs(info["work"] - work), info["work"]
            worst = max(worst, abs(sum(info[name] for name in ENERGIES) - begun - work))
        found.append(worst / turned)
    return float(np.median(found))


def rate(env: Any, steps: int, n: int = 1) -> float:
    """Return the steps per second of wall time of an environment under random actions."""
    return n * steps / periods(env, steps, time.perf_counter, keep_on=n == 1)


def rates() -> pages.Found:
    """Measure steps per second of `Pendulum-v1`, of one arm, and of 1024 arms on one and on two threads, alternately.

    The vectors run with full torques, and with a quarter of the torque limits also with `COARSE` links and modes.
    """
    arm = arms.named("three_dof")
    weak = dataclasses.replace(arm, torque_limits=tuple(0.25 * limit for limit in arm.torque_limits or ()))
    modes = {"formulation": "floating_frame", **FRAMES[0]}
    kinds: list[dict[str, Any]] = [{}, *({"arm": weak, **own} for own in ({}, *COARSE, modes))]
    vectors = [gym.make_vec(ID, num_envs=1024, threads=k, **own) for own in kinds for k in (1, 2)]
    environments = [(gym.make("Pendulum-v1"), 4000, 1), (gym.make(ID), 1000, 1), *((env, 100, 1024) for env in vectors)]
    for env, _, n in environments:
        rate(env, 20, n)  # what is compiled when first needed
    found = [[rate(*each) for each in environments] for _ in range(5)]
    base, one, *many = np.median(found, axis=0).tolist()
    return {"pendulum": base, "one": one, "many": [many[k : k + 2] for k in range(0, len(many), 2)]}


def accuracy(episodes: int) -> list[pages.Found]:
    """Return the tip errors against a refined run after each of `TIMES` periods, over the arm's reach."""
    rows: list[pages.Found] = []
    for share in (1.0, 0.25):
        exact = tips(share, episodes, **REFERENCE)
        frames = [] if share == 1.0 else [{"formulation": "floating_frame", **own} for own in FRAMES]
        coarse = COARSE[:1] if share == 1.0 else COARSE
        for settings in (*coarse, *CANDIDATES, *frames):
            off = np.linalg.norm(tips(share, episodes, **settings) - exact, axis=2) / 1.15
            errors = [float(np.quantile(off[:k].max(0), 0.98)) for k in TIMES]
            rows.append({"share": share, **settings, "errors": errors})
    return rows


def measure(options: argparse.Namespace) -> pages.Found:
    """Measure tip errors, energy balances and rates."""
    return pages.parts(options, "space_envs", {
        "accuracy": lambda: accuracy(options.episodes),
        "books": lambda: [{**one, **{who: books(who, **one) for who in ("pd", "full")}} for one in KEPT],
        "rates": rates,
    })  # fmt: skip


def percent(share: float) -> str:
    """Format a share as a percentage with two digits."""
    return f"{100 * share:.0f} %" if share >= 0.1 else f"{100 * share:.2g} %"


def mesh(row: pages.Found) -> str:
    """Describe the mesh of a link."""
    own = next(f"{row[name]} {name}" for name in ("elements", "modes", "segments") if name in row)
    own = own.removesuffix("s") if own.startswith("1 ") else own
    return f"{own}, `rho_inf` {row['rho_inf']}" if "rho_inf" in row else own


def blocks(found: pages.Found) -> pages.Blocks:
    """Format the tables of the page."""
    shares, step = {1.0: "full", 0.25: "a quarter"}, "{:.3g} ms".format
    errors = [
        (shares[row["share"]], mesh(row), step(1e3 * row["dt"]), *(percent(e) for e in row["errors"]))
        for row in found["accuracy"]
    ]
    kept = [
        (row["elements"], step(1e3 * row["dt"]), percent(row["pd"]), percent(row["full"])) for row in found["books"]
    ]
    rates, base = found["rates"], found["rates"]["pendulum"]
    kinds = [(shares[1.0], CANDIDATES[0]), *((shares[0.25], own) for own in (CANDIDATES[0], *COARSE, FRAMES[0]))]
    fast = [
        (share, mesh(own), step(1e3 * own["dt"]), *(f"{each / base:.2f}" for each in pair))
        for (share, own), pair in zip(kinds, rates["many"], strict=True)
    ]
    return {
        "accuracy": table("torques | mesh of a link | dt | after 0.1 s | 0.2 s | 0.3 s | 0.5 s", errors),
        "books": table("elements | dt | under `pd` | full torques of random sign", kept),
        "rates": [
            f"The rates are steps per second, divided by the {base:,.0f} steps per second of `Pendulum-v1` in the same "
            f"run. A single arm has the relative rate {rates['one'] / base:.2f}. The table has the rates of 1024 arms:",
            "",
            *table("torques | mesh of a link | dt | on one thread | on two threads", fast),
        ],
    }


if __name__ == "__main__":
    only = {"only": {"nargs": "+", "choices": ("accuracy", "books", "rates"), "help": "measure only these parts"}}
    page = "environments/spatial_results"
    sys.exit(pages.run("space_envs", __doc__, measure, blocks, page=page, more=only, episodes=32))
