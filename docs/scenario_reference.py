"""Writes docs/scenario: every key of every scenario, from the schema itself.

python docs/scenario_reference.py          # `make docs` does so, too; a test compares
"""

import json
import re
from pathlib import Path

from stickslip.data.schema import Whole
from stickslip.experiments.registry import EXPERIMENTS
from stickslip.experiments.sweep.definition import DRAWN, KINDS, MODES, MOST, OPTIONS, SPACED

EXAMPLES = Path(__file__).parents[1] / "examples"
TITLES = {
    "disk-array": "Keys of disk arrays",
    "sphere-shear": "Keys of sheared packings",
    "quasi-rigid": "Keys of quasi-rigid tests",
    "flow": "Keys of flows",
    "gouge": "Keys of fault gouge",
    "rate-state": "Keys of sliders",
}
HEAD = "| key | type | default | allowed | unit | |\n|---|---|---|---|---|---|"
SWEEP = {
    "mode": ("how keys go together: every value with every other, first with first, or a Latin hypercube", '"grid"'),
    "number": ('points of a sample, or of every key with `mode = "zip"`', "–"),
    "draw_seed": ("of all draws", "0"),
}
VALUES = {
    "linspace": "two ends, evenly",
    "geomspace": "two ends, evenly in the logarithm",
    "uniform": "drawn between two ends",
    "loguniform": "drawn between two ends, uniform in the logarithm",
    "integers": "drawn, both ends possible",
    "normal": "drawn; mean and sd",
    "count": "for `seed` alone: the scenario's, the next one, and so on",
}


def write(folder: Path) -> None:
    """One page for every experiment, one for [sweep], and what leads to them; unchanged pages are left alone."""
    texts = {"README": start(), "sweep": sweep_page()}
    texts |= {name: page(name, one.scenario) for name, one in EXPERIMENTS.items()}
    folder.mkdir(exist_ok=True)
    for name, text in texts.items():
        path = folder / f"{name}.md"
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def start() -> str:
    """The page that leads to the others."""
    rows = "\n".join(f'| `experiment = "{name}"` | [{TITLES[name]}]({name}.md) |' for name in EXPERIMENTS)
    return f"""# Scenarios, key by key

A scenario is a TOML file (or nested dictionaries, `ss.scenario(**tables)`) that defines a run,
`stickslip run FILE --out FOLDER`. Keys that are not given take their defaults. An unknown key, or a value that is not
allowed, is refused in one sentence before anything runs.
These pages are written from the schema by `python docs/scenario_reference.py`.

| | |
|---|---|
{rows}
| `[sweep]` in any of them | [Keys of sweeps](sweep.md): many runs from one scenario |

Where a page says `length`, `mass`, `force`, units are your own, consistent ones; `m`, `s`, `Pa` are SI. A dash as unit
means a pure number, or words.
"""


def page(name: str, kind: type[Whole]) -> str:
    """All tables of one kind of scenario, and its examples."""
    schema = kind.model_json_schema()
    parts = [f"# {TITLES[name]}", f'`experiment = "{name}"`. {schema["description"]}', _tables(schema, schema, "", {})]
    for path in sorted(EXAMPLES.glob("*.toml")):
        text = path.read_text(encoding="utf-8")
        if re.search(rf'^experiment = "{name}"', text, flags=re.M) and "\n[sweep]" not in text:
            parts.append(f"## Example: `examples/{path.name}`\n\n```toml\n{text.strip()}\n```")
    return "\n\n".join(parts) + "\n"


def _tables(table: dict, whole: dict, place: str, seen: dict) -> str:
    """The rows of one table, then the tables within it; `seen` says where each kind of table stands already."""
    rows, inner = [], []
    for key, entry in table["properties"].items():
        below = list(_references(entry))
        rows.append(_row(key, entry, whole, below, key in table.get("required", [])))
        branches = [entry, *entry.get("anyOf", [])]
        many = any(branch.get("type") == "array" and _references(branch) for branch in branches)
        inner += [(f"[[{place}{key}]]" if many else f"[{place}{key}]", reference) for reference in below]
    text = "\n".join([HEAD, *rows])
    for header, reference in inner:
        found = whole["$defs"][reference]
        if "const" in found["properties"].get("kind", {}):
            header += f' with kind = "{found["properties"]["kind"]["const"]}"'
        if reference in seen:
            text += f"\n\n`{header}` is as `{seen[reference]}`."
            continue
        seen[reference] = header
        inside = _tables(found, whole, f"{header.split(']')[0].strip('[')}.", seen)
        text += f"\n\n## `{header}`\n\n{found['description']}\n\n{inside}"
    return text


def _references(entry) -> list[str]:
    """Names of the tables that an entry may hold."""
    if isinstance(entry, dict):
        own = [entry["$ref"].rsplit("/", 1)[1]] if "$ref" in entry else []
        inner = [value for key, value in entry.items() if key not in ("default", "discriminator")]
        return own + [name for value in inner for name in _references(value)]
    return [name for value in entry for name in _references(value)] if isinstance(entry, list) else []


def _row(key: str, entry: dict, whole: dict, below: list[str], required: bool) -> str:
    words, unit = split(entry.get("description", ""))
    default = "**needed**" if required else _default(entry.get("default"), bool(below))
    if below and not words:
        words = _plain(whole["$defs"][below[0]]["description"]) if len(below) == 1 else "see below"
    cells = [f"`{key}`", _type(entry), default, _allowed(entry) or "–", unit or "–", words]
    return "| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in cells) + " |"


def split(description: str) -> tuple[str, str]:
    """Words, and the unit that stands in brackets at their end."""
    found = re.fullmatch(r"(.*?)\s*\[([^\[\]]*)\]", description, flags=re.S)
    return (found[1], found[2]) if found else (description, "")


def _plain(text: str) -> str:
    return " ".join(text.split("\n\n")[0].split())


def _default(value, table: bool) -> str:
    if table and isinstance(value, dict):
        return "its defaults"
    return "–" if value is None or value in ([], {}) else f"`{json.dumps(value, ensure_ascii=False)}`"


def _type(entry: dict) -> str:
    names = {"number": "number", "integer": "whole number", "boolean": "true, false", "string": "word"}
    if "anyOf" in entry or "oneOf" in entry:
        kinds = [_type(branch) for branch in entry.get("anyOf", entry.get("oneOf"))]
        return " or ".join(dict.fromkeys(kind for kind in kinds if kind))
    if "$ref" in entry:
        return "table"
    if "const" in entry or "enum" in entry:
        return "word" if isinstance(entry.get("const", entry.get("enum", [""])[0]), str) else "whole number"
    if entry.get("type") == "array":
        if "prefixItems" in entry:
            return f"pair of {_type(entry['prefixItems'][0])}s"
        return f"list of {_type(entry['items']).replace('pair', 'pairs')}s".replace("ss", "s")
    if entry.get("type") == "object":
        return f"{_type(entry['additionalProperties'])} by name"
    return names.get(entry.get("type"), "")


def _allowed(entry: dict) -> str:
    if "const" in entry:
        return f"`{json.dumps(entry['const'])}`"
    if "enum" in entry:
        return ", ".join(f"`{json.dumps(value)}`" for value in entry["enum"])
    if entry.get("type") == "array":
        few, most = entry.get("minItems"), entry.get("maxItems")
        each = _allowed(entry["prefixItems"][0] if "prefixItems" in entry else entry["items"])
        number = "" if few is None or few == most else f"at least {few}" if most is None else f"{few} to {most}"
        return "; ".join(filter(None, [number, each and f"each {each}"]))
    if "anyOf" in entry:
        return "; ".join(dict.fromkeys(filter(None, map(_allowed, entry["anyOf"]))))
    low, high = entry.get("minimum"), entry.get("maximum")
    if low is not None and high is not None:
        return f"{low:.15g} to {high:.15g}"
    signs = {
        "exclusiveMinimum": "> {:.15g}",
        "minimum": "≥ {:.15g}",
        "exclusiveMaximum": "< {:.15g}",
        "maximum": "≤ {:.15g}",
    }
    found = [sign.format(entry[name]) for name, sign in signs.items() if name in entry]
    return ", ".join(found + ([f"at most {entry['maxLength']} characters"] if "maxLength" in entry else []))


def sweep_page() -> str:
    """The options of [sweep] and the kinds of values, as the code knows them."""
    modes = ", ".join(f'`"{mode}"`' for mode in MODES)
    options = "\n".join(
        f"| `{name}` | {SWEEP[name][1]} | {modes if name == 'mode' else 'whole number'} | {SWEEP[name][0]} |"
        for name in OPTIONS
    )
    forms = {name: f"{{{name} = [a, b], number = n}}" for name in (*SPACED, *DRAWN)}
    forms |= {"normal": "{normal = {mean = m, sd = s}, number = n}", "count": "{count = n}"}
    values = "\n".join(f"| `{forms[name]}` | {VALUES[name]} |" for name in KINDS)
    example = (EXAMPLES / "rate_state_sweep.toml").read_text(encoding="utf-8").strip()
    return f"""# Keys of sweeps

`[sweep]` is a table in any scenario; `stickslip run` then makes a dataset of all members. What the modes do, what is
left behind and how clusters are used stands on the page [many runs](../many_runs.md).

| key | default | allowed | |
|---|---|---|---|
{options}

All other keys are keys of the scenario, dotted and in quotes, with entries of lists counted from one
(`"legs.2.velocity"`). At most {MOST} members are allowed. A value is a list, or one of

| | |
|---|---|
{values}

## Example: `examples/rate_state_sweep.toml`

```toml
{example}
```
"""


if __name__ == "__main__":
    write(Path(__file__).parent / "scenario")
