"""Time the decisions of an exported policy in C.

    python -m benchmarks.policy_in_c

For each packaged policy, compiled with `cc -O2`, the script prints a time per decision, in µs: the smallest of 50
means, each over 200 decisions.
"""

import subprocess
import tempfile
from pathlib import Path

from flexarm_env.control import load_policy

PROGRAM = Path(__file__).with_name("policy_timed.c")


def decision_time(name: str) -> float:
    """Return the time of one decision of a packaged policy in C, s."""
    observed = load_policy(name).weights[0][0].shape[0]
    with tempfile.TemporaryDirectory() as folder:
        written = ["flexarm", "export", name, "--to", "c", "--out", "policy.c"]
        subprocess.run(written, cwd=folder, check=True, capture_output=True)
        (Path(folder) / "timed.c").write_text(PROGRAM.read_text("utf-8").replace("SIZE", str(observed)))
        subprocess.run(["cc", "-O2", "-o", "timed", "timed.c", "-lm"], cwd=folder, check=True)
        return float(subprocess.run(["./timed"], cwd=folder, check=True, capture_output=True, text=True).stdout)


if __name__ == "__main__":
    for name in ("flexible_arm", "two_link"):
        print(f"{name}: {1e6 * decision_time(name):.1f} µs")
