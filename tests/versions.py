"""The oldest and the newest releases of what the package needs, as pyproject.toml allows them: do they work, same bits?

`make test-versions` runs `python -m tests.versions`: for each Python from 3.11 on that the machine has, it makes an
environment of the newest releases under .venv-versions/, for 3.11 one of the lower bounds too (which have builds for
that Python alone), and moves a few arms in each. A single environment must equal the vector one bit for bit; all must
agree within 1e-12 of each case's largest number (observations, which are float32, within float32's resolution), those
of one NumPy bit for bit. The exit code is 1 where something fails.
"""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / ".venv-versions"
NEEDED = ("llvmlite", "numpy", "scipy", "gymnasium")
PYTHONS = ("python3.11", "python3.12", "python3.13", "python3.14")
TOLERANCE = {"float64": 1e-12, "float32": 1.2e-7}


def pythons() -> list[str]:
    """Those that the machine has: that run, not those of which it has only a name."""
    found = filter(shutil.which, PYTHONS)
    return [p for p in found if subprocess.run([p, "-c", ""], capture_output=True, check=False).returncode == 0]


def ages(python: str) -> tuple[str, ...]:
    """Which requirements a Python is tried with: there are builds of the lower bounds for the first Python alone."""
    return ("oldest", "newest") if python == PYTHONS[0] else ("newest",)


def bounds() -> dict[str, tuple[str, str]]:
    """Package: its lowest version and its whole requirement."""
    with open(ROOT / "pyproject.toml", "rb") as file:
        wanted = tomllib.load(file)["project"]["dependencies"]
    found = {}
    for text in wanted:
        match = re.match(r"([a-z0-9_-]+)>=([0-9.]+)", text)
        if match and match[1] in NEEDED:
            found[match[1]] = (match[2], text)
    assert set(found) == set(NEEDED), f"pyproject.toml gives no lower bound of {set(NEEDED) - set(found)}"
    return found


def plain() -> dict[str, str]:
    """This process's variables without those that would lead another Python here."""
    return {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}


def interpreter(folder: Path) -> Path:
    """Of an environment."""
    return folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def made(python: str, folder: Path, *wanted: str | Path) -> Path:
    """The interpreter of a new environment with what pip is told to install."""
    shutil.rmtree(folder, ignore_errors=True)
    subprocess.run([python, "-m", "venv", folder], check=True, env=plain())
    pip = [interpreter(folder), "-m", "pip", "install", "--disable-pip-version-check", "--quiet"]
    subprocess.run([*pip, *wanted], check=True, env=plain())
    return interpreter(folder)


def environment(python: str, age: str) -> Path:
    """The interpreter of an environment; made where there is none of the same requirements."""
    wanted = [f"{name}=={low}" if age == "oldest" else text for name, (low, text) in bounds().items()]
    folder = FOLDER / f"{python}-{age}"
    stamp = folder / "requirements.txt"
    if not stamp.exists() or stamp.read_text() != "\n".join(wanted):
        made(python, folder, "--only-binary", ":all:", *wanted)
        stamp.write_text("\n".join(wanted))
    return interpreter(folder)


def moved(path: str) -> None:
    """Move arms in this environment; numbers of every case to a file. Single and vector must agree bit for bit."""
    import gymnasium as gym

    import flexarm_env  # noqa: F401  (registers the environments)
    from flexarm_env.scenes import named
    from flexarm_env.simulation import simulate

    versions = ", ".join(f"{name} {__import__(name).__version__}" for name in NEEDED)
    print(f"Python {sys.version.split()[0]}, {versions}", flush=True)
    assert "numba" not in sys.modules
    found = {"numpy": np.array([int(part) for part in np.__version__.split(".")[:2]])}
    exact = {"formulation": "geometrically_exact", "elements": 2}
    cases = (("FlexibleArm-v0", {}), ("TwoLinkFlexArm-v0", exact), ("SpatialFlexArm-v0", {}))
    scenes = (("elastica", {"nodes": 4}), ("floating_frame", {"segments": 2}))
    for name, options in cases:
        count, seen, rewards = 16, [], []
        many = gym.make_vec(name, num_envs=count, threads=2, vectorization_mode="vector_entry_point", **options)
        seen.append(many.reset(seed=3)[0])
        action = np.random.default_rng(5).uniform(-1.0, 1.0, (10, count, many.single_action_space.shape[0]))
        action = action.astype(np.float32)
        for one in action:
            observation, reward, *_ = many.step(one)
            seen += [observation.copy(), reward.copy()[:, None]]
            rewards.append(reward.copy())
        many.close()
        for i in (0, 11):
            single = gym.make(name, **options)
            alone = [single.reset(seed=3 + i)[0]]
            for one in action:
                observation, reward, *_ = single.step(one[i])
                alone += [observation, np.array([reward])]
            for mine, theirs in zip(alone, seen, strict=True):
                assert np.array_equal(mine, theirs[i]), f"{name}: arm {i} of the vector is not the single one"
        found[name] = np.array(rewards)
        found[f"{name}, observations"] = np.concatenate([part.ravel() for part in seen if part.dtype == np.float32])
    for formulation, options in scenes:
        run = simulate(named("two_link_motion"), formulation, dt=0.05, duration=1.0, estimate_error=False, **options)
        found[f"two_link_motion, {formulation}"] = np.concatenate([np.ravel(x) for x in (run.tip, run.q, run.energy)])
    np.savez(path, **found)


def compared(files: dict[str, Path], python: Path) -> bool:
    """Whether the files' numbers agree; run by an environment, which has NumPy."""
    named = {word: str(path) for word, path in files.items()}
    lines = f"from tests.versions import agree; import sys; sys.exit(not agree({named}))"
    return subprocess.run([python, "-c", lines], cwd=ROOT, check=False).returncode == 0


def agree(files: dict[str, str]) -> bool:
    """Whether all agree within TOLERANCE of the largest number, those of one NumPy to the last bit; says how far."""
    kept = {word: dict(np.load(path)) for word, path in files.items()}
    numpys = {word: tuple(numbers.pop("numpy")) for word, numbers in kept.items()}
    first, good = next(iter(kept.values())), True
    for word, numbers in kept.items():
        far = {k: float(np.max(np.abs(x - first[k])) / np.max(np.abs(first[k]))) for k, x in numbers.items()}
        like = kept[next(other for other in kept if numpys[other] == numpys[word])]
        same = all(np.array_equal(x, like[k]) for k, x in numbers.items())
        print(f"{word}: {max(far.values()):.1e} from the first{'' if same else '; NOT the bits of the same NumPy'}")
        good = good and same and all(far[k] <= TOLERANCE[x.dtype.name] for k, x in numbers.items())
    return good


def main() -> int:
    """All environments; 1 where one fails."""
    files, inside, good = {}, Path(sys.executable), True
    for python in pythons():
        for age in ages(python):
            inside, word = environment(python, age), f"{python} {age}"
            files[word] = FOLDER / f"{python}-{age}.npz"
            files[word].unlink(missing_ok=True)
            command = [inside, "-c", f"from tests.versions import moved; moved({str(files[word])!r})"]
            own = {"FLEXARM_CACHE_DIR": str(FOLDER / "cache")}
            if subprocess.run(command, cwd=ROOT, env=os.environ | own, check=False).returncode:
                print(f"{word}: FAILED")
                del files[word]
                good = False
    return 0 if good and compared(files, inside) else 1


if __name__ == "__main__":
    sys.exit(main())
