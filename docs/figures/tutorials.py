"""Pictures at the end of the tutorials: run a page's code and plot what it made.

python docs/figures/tutorials.py [PAGE ...]
"""

import os
import re
import sys
import tempfile
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1]))

STEP = "    over = terminated or truncated\n"


def names_of(page, *changes, shortened=False):
    """Run the code of a tutorial, with lines replaced, and return its names; shortened: as the tests do."""
    from tests.test_docs import script_of

    text = (HERE.parent / "tutorials" / f"{page}.md").read_text("utf-8")
    code = script_of(text if shortened else re.sub(r"<!-- shortened.*?-->\n\n", "", text))
    for old, new in changes:
        assert old in code, old
        code = code.replace(old, new)
    names = {"__name__": "__main__", "LOG": []}
    Path(f"{page}_page.py").write_text(code, "utf-8")
    exec(compile(code, f"{page}_page.py", "exec"), names)
    return names


def save(page, figure):
    """Write docs/figures/tutorial_PAGE.png."""
    figure.tight_layout()
    figure.savefig(HERE / f"tutorial_{page}.png", dpi=100)
    plt.close(figure)


def lines(page, t, ys, ylabel, goals=()):
    """One axis: ys over t in s."""
    figure, axis = plt.subplots(figsize=(6.4, 3.0))
    for label, y in ys.items():
        axis.plot(t, y, label=label)
    for goal in goals:
        axis.axhline(goal, color="0.6", linewidth=0.8, linestyle="--")
    axis.set(xlabel="t (s)", ylabel=ylabel)
    if len(ys) > 1:
        axis.legend()
    save(page, figure)


def training_loop():
    old = "        over = terminated | truncated\n\n"
    log = names_of("training-loop", (old, old + "        LOG.append(reward.mean())\n"))["LOG"]
    mean = np.array(log).reshape(-1, 128).mean(1)
    figure, axis = plt.subplots(figsize=(6.4, 3.0))
    axis.plot(16 * 128 / 1e3 * np.arange(1, len(mean) + 1), mean)
    axis.set(xlabel="control periods (1000)", ylabel="mean reward per period")
    save("training_loop", figure)


def controller():
    track = STEP + "    LOG.append(info['tip_position'])\n"
    log = np.array(names_of("controller", (STEP, track))["LOG"])
    lines("controller", 0.02 * np.arange(1, len(log) + 1), {"tip": np.arctan2(*log.T[::-1])}, "tip angle (rad)", [0.8])


def wrappers():
    old = "    periods, over = periods + 1, terminated or truncated\n"
    log = np.array(names_of("wrappers", (old, old + "    LOG.append(info['tip_position'])\n"))["LOG"])
    t = 0.02 * np.arange(1, len(log) + 1)
    lines("wrappers", t, {"tip": np.arctan2(*log.T[::-1])}, "tip angle (rad)", [0.5, -0.5, 0.0])


def own_arm():
    names_of("own-arm", shortened=True)
    (HERE / "tutorial_own_arm.png").write_bytes(Path("my_slew.png").read_bytes())


def from_a_log():
    names_of("from-a-log")
    (HERE / "tutorial_from_a_log.png").write_bytes(Path("fit/log.png").read_bytes())


def circle():
    names_of("circle")
    rows = np.genfromtxt("moved.csv", delimiter=",", names=True)
    lines("circle", rows["t"], {"hub": rows["angle0"]}, "hub angle (rad)")


def sensors():
    names = names_of("sensors")
    seen, t = names["seen"], names["run"].t
    figure, axes = plt.subplots(1, 2, figsize=(8.0, 3.0))
    for axis, name, unit in zip(axes, ("hub_angle", "strain_gauge_1"), ("rad", "strain"), strict=True):
        axis.plot(t, seen[name])
        axis.set(xlabel="t (s)", ylabel=f"{name} ({unit})")
    save("sensors", figure)


def randomisation():
    names = names_of("randomisation", shortened=True)
    labels = ["pd", "zvd", "lqr", "time_optimal"]
    pairs = [(names["success"](n), names["success"](n, randomization=names["wide"])) for n in labels]
    figure, axis = plt.subplots(figsize=(6.4, 3.0))
    for k, (label, shares) in enumerate(zip(("nominal", "drawn"), zip(*pairs, strict=True), strict=True)):
        axis.bar(np.arange(4) + 0.35 * k, shares, 0.35, label=label)
    axis.set_xticks(np.arange(4) + 0.175, labels)
    axis.set(ylabel="success", ylim=(0.0, 1.3))
    axis.legend(ncols=2, loc="upper right")
    save("randomization", figure)


def pictures(page, images):
    """Pictures side by side, in rows of three."""
    columns = min(3, len(images))
    rows, size = -(-len(images) // columns), 2.4 if len(images) > 1 else 4.4
    figure, axes = plt.subplots(rows, columns, figsize=(size * columns, size * rows), squeeze=False)
    for axis, image in zip(axes.flat, images, strict=True):
        axis.imshow(image)
        axis.axis("off")
    save(page, figure)


def wall():
    pictures("wall", [names_of("wall")["picture"]])


def contact():
    plt.imsave(HERE / "tutorial_contact.png", names_of("contact")["picture"])


def vector():
    pictures("vector", names_of("vector")["pictures"])


PAGES = controller, wrappers, own_arm, vector, wall, contact, sensors, randomisation, from_a_log, training_loop, circle

if __name__ == "__main__":
    wanted = sys.argv[1:] or [page.__name__ for page in PAGES]
    home = Path.cwd()
    for page in PAGES:
        if page.__name__ in wanted:
            with tempfile.TemporaryDirectory() as folder:
                os.chdir(folder)
                page()
                os.chdir(home)
