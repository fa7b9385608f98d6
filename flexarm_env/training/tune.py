"""Tune the gains of the classical controllers by random search and then Nelder-Mead, on separate episodes.

    flexarm tune --env FlexibleArm-v0                   # all controllers but mpc
    flexarm tune --env TwoLinkFlexArm-v0 --controllers pd,lqr
    flexarm tune --env TwoLinkFlexArm-v0 --controllers pd,zv --margin 0 --out reach.toml
    flexarm tune --env FlexibleArm-v0 --controllers pd,zv,zvd,lqr --randomized --out slew.toml
    flexarm tune --env FlexibleArm-v0 --env-kwargs '{"arm": "mine.toml"}' --controllers pd,zvd --out mine_gains.toml

The search minimizes the mean settling time plus a penalty. The penalty is the episode's duration times the fraction of
failed episodes. The tuning episodes are used for neither training nor evaluation. The search starts from the gains in
the output file, or from the gains of the package if the output file does not exist. The output file is --out or, by
default, runs/gains/TASK.toml. Pass the file to `flexarm evaluate --policy zv@FILE`. In a checkout,
`python -m agents.tune` instead writes flexarm_env/data/control/TASK.toml, the file that `flexarm_env.control.make`
reads.

Gains of pd, zv and zvd must have a minimum gain margin (--margin; default: a factor of 2, which is 6 dB). The closed
loop of the linearized arm, sampled at the control period, must be stable with all gains multiplied by the margin.
Without a gain margin (--margin 0) the search finds unstable loops. An unstable loop ends in a limit cycle in which the
elbow's torque changes sign in every period.
"""

import json
import shlex
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from flexarm_env import control
from flexarm_env import validation as check
from flexarm_env.control.catalogue import gains_from, tuned_gains
from flexarm_env.files import read_toml, to_file
from flexarm_env.training import episodes
from flexarm_env.training.runs import command, write_text
from flexarm_env.validation import Array

WEIGHTS = {"angle": (0.3, 300.0), "rate": (0.03, 100.0), "bend": (0.03, 300.0), "bend_rate": (0.03, 300.0)}
PD = {"bandwidth": (0.05, 3.0), "ratio": (0.3, 3.0)}
SEARCHED: dict[str, dict[str, tuple[float, float]]] = {
    "pd": PD,
    "zv": PD | {"effort": (0.2, 1.0)},
    "zvd": PD | {"effort": (0.2, 1.0)},
    "lqr": WEIGHTS | {"noise": (0.003, 3.0)},
    "lqg": WEIGHTS | {"noise": (1e-3, 0.1), "push": (1e-3, 0.1), "drift": (5e-5, 5e-3)},
    "mpc": dict.fromkeys(WEIGHTS, (5.0, 100.0)) | {"memory": (0.5, 1.0)},
    "time_optimal": {"effort": (0.8, 1.0)} | WEIGHTS | {"noise": (0.003, 3.0)},
}
"""Searched gains with their ranges, on a logarithmic scale."""

OWN: dict[str, tuple[float, float]] = {"bandwidth": (0.02, 3.0), "ratio": (0.02, 3.0)}
"""Ranges of the searched gains for a user's own arm; with a light hub or elbow the sampled loop tolerates little
damping."""

WIDE: dict[str, tuple[float, float]] = {"bandwidth": (0.02, 3.0), "ratio": (0.3, 10.0)}
"""Ranges of the searched gains for randomized arms; loops that suit all randomized arms are slower and better
damped."""

PER_JOINT = ("bandwidth", "ratio")

NONE = 1e3
"""Cost, s, of gains that lack the gain margin, or with which a controller's design has no solution."""

MARGIN = 2.0
"""Required gain margin of PD control: 6 dB."""


@dataclass(frozen=True)
class Arguments:
    """Arguments of `flexarm tune`.

    Args:
        env: id of the environment.
        env_kwargs: keywords of the environment, as JSON: {"arm": "mine.toml"}.
        controllers: names of controllers, separated by commas; default: all except mpc, whose search takes long.
        samples: number of samples in the random search.
        refinements: number of Nelder-Mead evaluations.
        episodes: number of episodes per evaluation.
        seed: seed of the search.
        margin: factor by which all PD gains can be multiplied while the linearized loop must stay stable; 0: no
            condition.
        out: file to which the gains are written.
        home: folder in which TASK.toml is written if --out is not given.
        dry: print the result and write nothing.
        randomized: tune on arms with random payload and stiffness, drawn as in `flexarm evaluate --randomized`.
    """

    env: str
    env_kwargs: dict[str, Any] = field(default_factory=dict)
    controllers: str = ",".join(name for name in SEARCHED if name != "mpc")
    samples: int = 80
    refinements: int = 120
    episodes: int = 64
    seed: int = 0
    margin: float = MARGIN
    out: str = ""
    home: Path = Path("runs/gains")
    dry: bool = False
    randomized: bool = False


class SearchProgress:
    """Cost function that also prints the progress of a search on standard error.

    In a terminal the progress occupies one line.

    Args:
        cost: function of the gains that returns their cost, s. name: name of the controller. total: largest number of
            evaluations in the search.
    """

    EVERY = (0.5, 10.0)  # s from one line to the next, on a terminal and elsewhere

    def __init__(self, cost: Callable[[Array], float], name: str, total: int) -> None:
        """Store the cost function and announce the search."""
        self.cost, self.name, self.total = cost, name, total
        self.begun = self.last = time.monotonic()
        self.count, self.least = 0, NONE
        self.terminal = sys.stderr.isatty()
        sys.stderr.write(f"tuning {name}: {total} gains at most\n")

    def __call__(self, values: Array) -> float:
        """Evaluate the cost of gains and report progress."""
        found = self.cost(values)
        self.count, self.least = self.count + 1, min(self.least, found)
        now = time.monotonic()
        if now - self.last >= self.EVERY[not self.terminal]:
            self.last = now
            best = "none can be used so far" if self.least >= NONE else f"least cost {self.least:.3f} s"
            text = f"{self.name}: {self.count} of {self.total}, {best}, {now - self.begun:.0f} s"
            sys.stderr.write(f"\r{text:70}" if self.terminal else f"{text}\n")
            sys.stderr.flush()
        return found

    def close(self) -> None:
        """Clear the line of a terminal that shows the progress."""
        if self.terminal:
            sys.stderr.write("\r" + " " * 70 + "\r")


def search(
    cost: Callable[[Array], float], bounds: Array, arguments: Arguments, start: Array | None
) -> tuple[Array, float]:
    """Minimize the cost over k gains within bounds (k, 2), by Sobol points and then Nelder-Mead.

    The two search methods vary the logarithms of the gains. start (k,): known gains that are evaluated first, or None.
    Returns the best gains and their cost.
    """
    from scipy.optimize import minimize
    from scipy.stats import qmc

    low, high = np.log(bounds[:, 0]), np.log(bounds[:, 1])
    level = (arguments.samples - 1).bit_length()  # the next power of 2, which SciPy wants and would warn of
    # Sobol's quasi-random points, because they cover the box more evenly than uniform draws
    points = qmc.Sobol(len(low), rng=arguments.seed).random_base2(level)[: arguments.samples]
    points = qmc.scale(points, low, high)
    if start is not None:
        points = np.vstack([np.clip(np.log(start), low, high), points])
    costs = [cost(np.exp(p)) for p in points]
    best = points[int(np.argmin(costs))]
    # initial simplex: steps of 0.25 in the logarithm
    steps = np.vstack([best, best + np.diag(np.where(best + 0.25 < high, 0.25, -0.25))])
    found = minimize(
        lambda p: cost(np.exp(p)), best, method="Nelder-Mead", bounds=np.stack([low, high], axis=1),
        options={"maxfev": arguments.refinements, "initial_simplex": steps, "xatol": 1e-2, "fatol": 1e-3},
    )  # fmt: skip
    return np.exp(found.x), float(found.fun)


def tune(name: str, env: Any, arguments: Arguments) -> tuple[dict[str, Any], episodes.Episodes]:
    """Tune a controller's gains; return the table of gains, and the episodes run with these gains."""
    setup = control.Setup.of(env)
    names, bounds = [], []
    # ranges of the PD gains depend on the arms
    others = WIDE if arguments.randomized else OWN if "arm" in arguments.env_kwargs else {}
    for key, limits in (SEARCHED[name] | (others if "ratio" in SEARCHED[name] else {})).items():
        for _ in range(setup.n_joints if key in PER_JOINT else 1):
            names.append(key)
            bounds.append(limits)

    def table(values: Array) -> dict[str, Any]:
        """Return gains by name, to four digits, from the vector of searched values."""
        out: dict[str, Any] = {}
        for key, value in zip(names, values, strict=True):
            number = float(f"{value:.4g}")
            out[key] = [*out.get(key, []), number] if key in PER_JOINT else number
        return out

    def trial(values: Array) -> episodes.Episodes:
        """Run the tuning episodes with the gains."""
        controller = control.make(name, setup, gains_from(name, table(values)))
        return episodes.run(env, controller, episodes.TUNING)

    def cost(values: Array) -> float:
        """Return the mean settling time plus duration times failure rate, s; NONE for gains that cannot be used."""
        gains = gains_from(name, table(values))
        if arguments.margin > 0.0 and isinstance(gains, control.PDGains) and not gains.stable(setup, arguments.margin):
            return NONE
        try:
            result = trial(values)
        except (np.linalg.LinAlgError, ValueError):  # a Riccati equation or a plan without solution
            return NONE
        duration = (len(result.errors) - 1) * result.dt
        return float(result.settling.mean() + duration * (1.0 - result.success.mean()))

    known = current(place(setup.task, arguments)).get(name) or current(arguments.home / f"{setup.task}.toml").get(name)
    if known is None:
        known = asdict(tuned_gains(name, setup.task, setup.n_joints))
    flat = [v for key in SEARCHED[name] for v in np.atleast_1d(known.get(key, np.nan))]
    start = np.array(flat) if len(flat) == len(names) and np.isfinite(flat).all() else None
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "PD gains are unstable")
        told = SearchProgress(cost, name, arguments.samples + arguments.refinements + (start is not None))
        best, least = search(told, np.array(bounds), arguments, start)
        told.close()
        if least >= NONE:
            what = f"{name}: none of the gains that were tried can be used on {setup.arm.name}"
            raise ValueError(f"{what}; use more --samples, or lqr, or --margin 0 (pd, zv, zvd)")
        return table(best), trial(best)


def place(task: str, arguments: Arguments) -> Path:
    """Return the path of the file with a task's gains."""
    return Path(arguments.out) if arguments.out else arguments.home / f"{task}.toml"


def current(path: Path) -> dict[str, Any]:
    """Read the existing file of tuned gains.

    Raises ValueError if the file is invalid, because rewriting the file would lose the gains.
    """
    tables = read_toml(path)[0] if path.is_file() else {}
    with check.in_file(path):
        check.known_keys("", tables, control.NAMES, "controller")
        for name, table in tables.items():
            gains_from(name, check.table_of(name, table))
    return tables


def text_of(tables: dict[str, Any], arguments: Arguments) -> str:
    """Format the gains of all controllers as TOML text."""
    how = ""
    for name, value in check.changed(arguments).items():
        if value != {} and name not in ("out", "home"):
            words = json.dumps(value) if isinstance(value, dict) else str(value)
            how += f" --{name.replace('_', '-')}" + ("" if value is True else f" {shlex.quote(words)}")
    lines = [
        f"# Gains of the controllers on {arguments.env}, the last of them found by `flexarm tune{how}`;",
        "# what they mean: flexarm_env/control/pd.py, shaping.py, lqr.py, lqg.py, mpc.py, time_optimal.py.",
    ]
    for name in control.NAMES:
        if name in tables:
            lines += ["", f"[{name}]", *(f"{key} = {value}" for key, value in tables[name].items())]
    return "\n".join(lines) + "\n"


def search_all(arguments: Arguments) -> None:
    """Tune the requested controllers, print and write the gains."""
    chosen = arguments.controllers.split(",")
    for name, least in {"samples": 1, "refinements": 1, "episodes": 1, "seed": 0}.items():
        check.integer(f"--{name}", getattr(arguments, name), minimum=least)
    check.number("--margin", arguments.margin, minimum=0.0)
    for name in chosen:
        check.choice("--controllers", name, tuple(SEARCHED))
    drawn = arguments.env_kwargs | ({"randomization": episodes.RANDOMIZED} if arguments.randomized else {})
    env = episodes.make_episodes(arguments.env, arguments.episodes, **drawn)
    setup = control.Setup.of(env)
    what = "must be an environment of the plane; gains in space are not searched"
    setup.arm.axes.check_planar("--env", arguments.env, what)
    # LQG observes joint angles and gauges instead of the full state
    measured = episodes.make_episodes(arguments.env, arguments.episodes, **drawn | {"observation": "measured"})
    task = setup.task
    path = place(task, arguments)
    tables = current(path)
    if not arguments.dry:
        to_file("--out", path)
    for name in chosen:
        if name == "time_optimal" and task != "slew":
            continue
        clock = time.perf_counter()
        tables[name], result = tune(name, measured if name == "lqg" else env, arguments)
        print(
            f"{name:13s} success {result.success.mean():.2f}  settling mean {result.settling.mean():.3f} s, "
            f"median {np.median(result.settling):.3f} s  {tables[name]}  ({time.perf_counter() - clock:.0f} s)",
            flush=True,
        )
        if not arguments.dry:
            write_text(path, text_of(tables, arguments))


def main(program: str = "flexarm tune", words: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    return command(Arguments, program, __doc__, search_all, words)
