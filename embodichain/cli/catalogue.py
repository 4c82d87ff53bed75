"""The catalogue of terms as a page of Markdown, made from what is registered.

`embodichain list terms --markdown > docs/terms.md` writes the one in docs.
"""

from __future__ import annotations

from collections.abc import Iterator

from embodichain.cli.term_entries import SECTION_OF, TermEntry, all_entries, shape_entries
from embodichain.lab.gym.envs.managers.registry import VALUE_KINDS

__all__ = ["catalogue"]

_HEAD = """\
# Terms

Made by `embodichain list terms --markdown`: every function that a task can name, with its
parameters and an example that a test builds. `embodichain show term NAME` prints the same on the
terminal. Units are SI and radians unless a line says otherwise; an *entity* is a reference such as
`{uid: ur10, link_names: [ee_link]}`; `[low, high]` bounds are ordered. N is the number of
environments.

A reward, a metric or a termination is one number of each environment: a [quantity](#quantities),
with a [shape](#shapes) where it has several columns or is to become a kernel or a truth. The
section of the task says which of them it is; an observation takes the columns as they are.

```yaml
rewards:
  reach: {func: distance, shape: {tanh: 0.1}, params: {from: {uid: cube}, to: {uid: goal}}}
  effort: {func: joint_effort, shape: l2, weight: -1.0e-5, params: {of: {uid: ur10}}}
metrics:
  success: {func: distance, shape: {below: 0.05}, params: {from: {uid: cube}, to: {uid: goal}}}
observations:
  qvel: {func: joint_velocity, scale: 0.1, params: {of: {uid: ur10}}}
```

`of`, `from` and `to` may be written `entity_cfg`, `source_entity_cfg` and `target_entity_cfg`, and
the other way round. [Other names](#other-names), which EmbodiChain, Isaac Lab, mjlab and dm_control
use, stand for a quantity with a shape.
"""
_BUILTIN = "embodichain."
_QUANTITIES = (
    "Serve observations, rewards, terminations and metrics, except where a line says otherwise."
)
_OTHERS = "Each has the parameters of what it stands for; words in capitals are its own."


def catalogue() -> str:
    """Return the page. Terms of other packages are not on it."""
    entries = [e for e in all_entries() if e.spec.func.__module__.startswith(_BUILTIN)]
    aliases = [e for e in entries if e.is_alias]
    values = [e for e in entries if set(e.kinds) & set(VALUE_KINDS) and not e.is_alias]
    lines = [_HEAD]
    parts: dict[str, list[TermEntry]] = {"quantities": values, "shapes": shape_entries()}
    for kind, section in SECTION_OF.items():
        if kind not in VALUE_KINDS:
            parts[section] = [e for e in entries if kind in e.kinds]
    lines += [f"* [{title}](#{title}): {len(found)}" for title, found in parts.items()]
    lines.append(f"* [other names](#other-names): {len(aliases)}")
    for title, found in parts.items():
        lines += ["", f"## {title}", ""]
        if title == "quantities":
            lines += [_QUANTITIES, ""]
        for entry in found:
            lines += _term(entry)
    lines += [
        "",
        "## other names",
        "",
        _OTHERS,
        "",
        "| name | for | stands for |",
        "| --- | --- | --- |",
    ]
    for entry in aliases:
        sections = ", ".join(SECTION_OF[kind] for kind in entry.kinds)
        meaning = entry.spec.doc.removeprefix("Stands for ").replace("``", "`").rstrip(".")
        lines.append(f"| `{entry.name}` | {sections} | {meaning} |")
    return "\n".join(lines).rstrip("\n") + "\n"


def _term(entry: TermEntry) -> Iterator[str]:
    yield f"### {entry.name}"
    yield ""
    yield entry.doc.text
    yield ""
    if entry.kinds and set(entry.kinds) <= set(VALUE_KINDS) and len(entry.kinds) < len(VALUE_KINDS):
        yield f"For {', '.join(SECTION_OF[kind] for kind in entry.kinds)}."
        yield ""
    rows = entry.parameters()
    if rows:
        yield "| parameter | type | default | what |"
        yield "| --- | --- | --- | --- |"
        for row in rows:
            default = f"`{row['default']}`" if row["default"] else "needed"
            cells = (f"`{row['parameter']}`", row["type"], default, row["what"])
            yield f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"
        yield ""
    if entry.doc.example:
        yield f"Example: `{entry.doc.example}`"
        yield ""
