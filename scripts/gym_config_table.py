"""Write into docs/compatibility.md which keys of EmbodiChain's configs are left out, and why.

`python scripts/gym_config_table.py` writes the table of `compat.gym_config` between two marks.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from embodichain.compat.gym_config import vocabulary as v
from embodichain.compat.gym_config.functors import LEFT_OUT, PARAMS_LEFT_OUT

PAGE = Path(__file__).parents[1] / "docs" / "compatibility.md"
BEGIN = "<!-- left out: begin -->\n"
END = "<!-- left out: end -->\n"
SECTIONS: Mapping[str, v.Vocabulary] = {
    "top": v.TOP,
    "`physics_config`": v.PHYSICS,
    "`robot`": v.ROBOT,
    "`robot.urdf_cfg`": v.URDF,
    "`articulation[]`": v.ARTICULATION,
    "`drive_pros`": v.DRIVE,
    "`solver_cfg`": v.SOLVER,
    "`root_props`": v.ROOT_PROPS,
    "`rigid_object[], background[]`": v.RIGID_OBJECT,
    "`attrs`": v.ATTRS,
    **{f"`shape ({kind})`": keys for kind, keys in v.SHAPES.items()},
    "`visual_material`": v.MATERIAL,
    "`light`": v.LIGHTS,
    "`light.direct[]`": v.LIGHT,
    "`sensor[]`": v.SENSORS,
    "`env`": v.ENV,
    "`env.events.*`": v.EVENT,
    "`env.actions.*`": v.ACTION,
    **{f"{kind}s": reasons for kind, reasons in LEFT_OUT.items()},
    **{f"`{functor}`": reasons for functor, reasons in PARAMS_LEFT_OUT.items()},
}
"""Section of a config -> its keys, with their rules."""


def rows() -> Iterator[tuple[str, str, str]]:
    """Yield each section, the keys that are left out for the same reason, and the reason."""
    for section, rules in SECTIONS.items():
        reasons = [rule for rule in rules.values() if isinstance(rule, str)]
        for reason in dict.fromkeys(reasons):
            keys = [f"`{key}`" for key, rule in rules.items() if rule == reason]
            yield section, ", ".join(keys), reason


def table() -> str:
    """Return the rows as a table."""
    lines = ["| where | what | why |", "| --- | --- | --- |"]
    for row in rows():
        lines.append(f"| {' | '.join(row)} |")
    return "\n".join(lines) + "\n"


def filled(text: str) -> str:
    """Return a page with the table between the marks."""
    head, _, rest = text.partition(BEGIN)
    _, _, tail = rest.partition(END)
    return f"{head}{BEGIN}{table()}{END}{tail}"


if __name__ == "__main__":
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
