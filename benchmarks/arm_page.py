"""Write the tables of arm files, scenes and solver options in docs/ from the fields of the package's records.

python -m benchmarks.arm_page
"""

from typing import Any

from benchmarks.machine import DOCS, table, write_text
from benchmarks.pages import filled
from flexarm_env import records
from flexarm_env.bodies import RigidLink
from flexarm_env.parameters import Arm, Base, Elbow, Joint, Motor, Payload
from flexarm_env.scene import Scene
from flexarm_env.sections import Link, Section
from flexarm_env.sensors import Camera, ContactSwitch, Encoder, Law, LowPass, StrainGauge
from flexarm_env.settings import Settings
from flexarm_env.training.runs import Training

KINDS: dict[str, Any] = {
    "arm": Arm, "link": Link, "section": Section, "rigid_link": RigidLink, "elbow": Elbow, "payload": Payload,
    "joint": Joint, "motor": Motor, "base": Base, "law": Law, "low_pass": LowPass,
    "encoder": Encoder, "strain_gauge": StrainGauge, "camera": Camera, "switch": ContactSwitch,
}  # fmt: skip

PAGES: dict[str, dict[str, Any]] = {
    "arm_files": KINDS, "scenes": {"scene": Scene}, "formulations": {"settings": Settings},
    "hyperparameters": {"run": Training},
}  # fmt: skip
"""Records of each page of docs/, by the name of their block."""


def page(name: str) -> str:
    """Return a page of docs/ with new tables; the other text is unchanged."""
    blocks = {}
    for block, kind in PAGES[name].items():
        inherited = records.rows(kind.__base__) if kind.__base__ is Law else []
        rows = [row for row in records.rows(kind) if row not in inherited]
        blocks[block] = table("key | default | unit and bounds | meaning", rows)
    return filled((DOCS / f"{name}.md").read_text(encoding="utf-8"), "arm_page", blocks)


if __name__ == "__main__":
    for name in PAGES:
        write_text(DOCS / f"{name}.md", page(name))
