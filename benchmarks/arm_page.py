"""Write the tables of docs/arm_files.md from the fields of the package's records.

python -m benchmarks.arm_page
"""

from benchmarks.machine import DOCS, table, write_text
from benchmarks.pages import filled
from flexarm_env import records
from flexarm_env.bodies import RigidLink
from flexarm_env.parameters import Arm, Base, Elbow, Joint, Motor, Payload
from flexarm_env.sections import Link, Section
from flexarm_env.sensors import Camera, ContactSwitch, Encoder, Law, LowPass, StrainGauge

PAGE = DOCS / "arm_files.md"
KINDS = {
    "arm": Arm, "link": Link, "section": Section, "rigid_link": RigidLink, "elbow": Elbow, "payload": Payload,
    "joint": Joint, "motor": Motor, "base": Base, "law": Law, "low_pass": LowPass,
    "encoder": Encoder, "strain_gauge": StrainGauge, "camera": Camera, "switch": ContactSwitch,
}  # fmt: skip


def page() -> str:
    """Return the page with new tables; the other text is unchanged."""
    blocks = {}
    for name, kind in KINDS.items():
        inherited = records.rows(kind.__base__) if kind.__base__ is Law else []
        rows = [row for row in records.rows(kind) if row not in inherited]
        blocks[name] = table("key | default | unit and bounds | meaning", rows)
    return filled(PAGE.read_text(encoding="utf-8"), "arm_page", blocks)


if __name__ == "__main__":
    write_text(PAGE, page())
