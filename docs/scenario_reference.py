"""Write docs/scenario, the reference of all scenario keys, from the schema.

python docs/scenario_reference.py          # also run by `make docs`; a test compares the result
"""

import json
import re
from pathlib import Path

from stickslip.core.progress import LIMITS, MOST
from stickslip.data.schema import ScenarioBase, split_unit
from stickslip.experiments.quantities import estimate, median
from stickslip.experiments.registry import EXPERIMENTS, table_of
from stickslip.runs.sweep.axes import DRAWN, KINDS, SPACED, Options, Values

EXAMPLES = Path(__file__).parents[1] / "examples"
HEAD = "| key | type | default | allowed | unit | |\n|---|---|---|---|---|---|"
MEASURES = """Each run provides these numbers in `results.h5`, as columns of sweeps, and in `result.to_dataframe()`. The
name of a number that belongs to an amplitude, a velocity or a load ends in `@` and that value."""
OVER = {  # the samples of a run
    estimate: "Each number is a mean over samples. A second number, whose name ends in `_error`, is half the\n"
    "width of its 95 % interval.",
    median: "Each number is the median over the samples for which it has a value.",
}
ALLOWED = {"where": "text, or list of texts", "draws": "path of a CSV file, or table of lists"}  # in [sweep]


def write(folder: Path) -> None:
    """Write one page per experiment, one for [sweep], and an overview; unchanged pages are not rewritten."""
    texts = {"README": start(), "sweep": sweep_page()}
    texts |= {name: page(name, one.scenario) for name, one in EXPERIMENTS.items()}
    folder.mkdir(exist_ok=True)
    for name, text in texts.items():
        path = folder / f"{name}.md"
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def title(name: str) -> str:
    """Title of the page of an experiment."""
    return f"{name.replace('-', ' ').capitalize()} scenarios"


def start() -> str:
    """Overview page."""
    counts = {kind: f"{most >> 30} GiB" if kind == "bytes" else _count(most) for kind, most in LIMITS.items()}
    limits = "\n".join(f"| {most} | {kind} |" for kind, most in counts.items())
    rows = "\n".join(f'| `experiment = "{name}"` | [{title(name)}]({name}.md) |' for name in EXPERIMENTS)
    return f"""# Scenario reference

A scenario is a TOML file (or nested dictionaries, `ss.scenario(**tables)`) that defines a run; start it with
`stickslip run FILE --out FOLDER`. Omitted keys take their default values. Unknown keys and invalid values are rejected
with an error message before anything runs. These pages are generated from the schema by
`python docs/scenario_reference.py`.

| | |
|---|---|
{rows}
| `[sweep]` in any of them | [Sweeps](sweep.md): many runs from one scenario |

Where the unit is given as `length`, `mass`, `force` and so on, any consistent units may be used;
`m`, `s` and `Pa` are SI units. A dash in the unit column means a dimensionless number or a string.

To name your units, set `units = "SI"` or `units = {{length = "mm", mass = "g", time = "s"}}`. They are then printed in
figures, tables, reports, archives, datasets and the headers of CSV files. Units of other quantities are products of
these, such as g mm/s² for a force (N and Pa in SI). No number changes. Experiments whose keys are in SI units accept
no other units.

## Sizes

Several keys together may require more than a machine can store or compute. Each scenario computes the sizes of its run
(`scenario.sizes()`). A scenario beyond these limits is rejected before anything is allocated or written. The functions
of `ss.packings`, `ss.protocols` and `ss.run` have the same limits.

| at most | of |
|---|---|
{limits}
"""


def page(name: str, kind: type[ScenarioBase]) -> str:
    """Page with all tables of one kind of scenario, and its examples."""
    schema = kind.model_json_schema()
    parts = [f"# {title(name)}", f'`experiment = "{name}"`. {schema["description"]}', _tables(schema, schema, "", {})]
    for path in sorted(EXAMPLES.glob("*.toml")):
        text = path.read_text(encoding="utf-8")
        if re.search(rf'^experiment = "{name}"', text, flags=re.M) and "\n[sweep]" not in text:
            parts.append(f"## Example: `examples/{path.name}`\n\n```toml\n{text.strip()}\n```")
    parts += measures(name)
    return "\n\n".join(parts) + "\n"


def measures(name: str) -> list[str]:
    """Section on the measures of a run, if the experiment lists them in a table."""
    table = table_of(EXPERIMENTS[name])
    if table is None:
        return []
    table_rows = [(f"`{one.name}`", "–" if one.unit == "1" else one.unit, _cell(one.meaning)) for one in table.values()]
    rows = [f"| {' | '.join(cells)} |" for cells in table_rows]
    words = f"{MEASURES}\n{OVER.get(table.over, '')}".rstrip()
    return ["\n".join(["## Measures of a run\n", words, "\n| name | unit | |", "|---|---|---|", *rows])]


def _tables(table: dict, whole: dict, place: str, seen: dict) -> str:
    """Rows of one table, followed by its inner tables; `seen` maps each kind of table to its first occurrence."""
    rows, inner = [], []
    for key, entry in table["properties"].items():
        below = list(_references(entry))
        rows.append(_row(key, entry, whole, below, key in table.get("required", [])))
        branches = [entry, *entry.get("anyOf", [])]
        many = any(branch.get("type") == "array" and _references(branch) for branch in branches)
        header = f"[[{place}{key}]]" if many else f"[{place}{key}]"
        inner += [(_header(header, whole["$defs"][one], len(below)), one) for one in below]
    text = "\n".join([HEAD, *rows])
    for header, reference in inner:
        found = whole["$defs"][reference]
        if reference in seen:
            same = "above" if seen[reference] == header else f"`{seen[reference]}`"
            text += f"\n\n`{header}` has the same keys as {same}."
            continue
        seen[reference] = header
        inside = _tables(found, whole, f"{header.split(']')[0].strip('[')}.", seen)
        text += f"\n\n## `{header}`\n\n{found['description']}\n\n{inside}"
    return text


def _header(header: str, table: dict, choices: int) -> str:
    kind = table["properties"].get("kind", {})
    return f'{header} with kind = "{kind["const"]}"' if choices > 1 and "const" in kind else header


def _references(entry) -> list[str]:
    """Names of the tables that an entry may contain."""
    if isinstance(entry, dict):
        own = [entry["$ref"].rsplit("/", 1)[1]] if "$ref" in entry else []
        inner = [value for key, value in entry.items() if key not in ("default", "discriminator")]
        return own + [name for value in inner for name in _references(value)]
    return [name for value in entry for name in _references(value)] if isinstance(entry, list) else []


def _row(key: str, entry: dict, whole: dict, below: list[str], required: bool) -> str:
    words, unit = split_unit(entry.get("description", ""))
    default = "**required**" if required else _default(entry.get("default"), bool(below))
    if below and not words:
        words = _plain(whole["$defs"][below[0]]["description"]) if len(below) == 1 else "see below"
    cells = [f"`{key}`", _type(entry), default, _allowed(entry) or "–", unit or "–", words]
    return "| " + " | ".join(_cell(cell) for cell in cells) + " |"


def _cell(text: str) -> str:
    """Text of a cell of a table."""
    return text.replace("|", "\\|").replace("\n", " ")


def _plain(text: str) -> str:
    return " ".join(text.split("\n\n")[0].split())


def _default(value, table: bool) -> str:
    if table and isinstance(value, dict):
        return "its defaults"
    return "–" if value is None or value in ([], {}) else f"`{json.dumps(value, ensure_ascii=False)}`"


def _type(entry: dict) -> str:
    names = {"number": "number", "integer": "integer", "boolean": "boolean", "string": "string"}
    if "anyOf" in entry or "oneOf" in entry:
        kinds = [_type(branch) for branch in entry.get("anyOf", entry.get("oneOf"))]
        return " or ".join(dict.fromkeys(kind for kind in kinds if kind))
    if "$ref" in entry:
        return "table"
    if "const" in entry or "enum" in entry:
        return "string" if isinstance(entry.get("const", entry.get("enum", [""])[0]), str) else "integer"
    if entry.get("type") == "array":
        if "prefixItems" in entry:
            return f"pair of {_type(entry['prefixItems'][0])}s"
        return f"list of {_type(entry['items']).replace('pair', 'pairs')}s".replace("ss", "s")
    if entry.get("type") == "object":
        return f"{_type(entry['additionalProperties'])} by name"
    return names.get(entry.get("type"), "")


def _count(value: float) -> str:
    """A number as in the text of the other pages: with commas from five digits on."""
    return (f"{value:,.15g}" if abs(value) >= 1e4 else f"{value:.15g}").replace("e+", "e")


def _allowed(entry: dict) -> str:
    if "const" in entry:
        return f"`{json.dumps(entry['const'])}`"
    if "enum" in entry:
        return ", ".join(f"`{json.dumps(value)}`" for value in entry["enum"])
    if entry.get("type") == "array":
        few, most = entry.get("minItems"), entry.get("maxItems")
        each = _allowed(entry["prefixItems"][0] if "prefixItems" in entry else entry["items"])
        number = "" if few is None or few == most else f"at least {few}" if most is None else f"{few} to {_count(most)}"
        return "; ".join(filter(None, [number, each and f"each {each.removeprefix('each ')}"]))
    if "anyOf" in entry:
        return "; ".join(dict.fromkeys(filter(None, map(_allowed, entry["anyOf"]))))
    low, high = entry.get("minimum"), entry.get("maximum")
    if low is not None and high is not None:
        return f"{_count(low)} to {_count(high)}"
    signs = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}
    found = [f"{sign} {_count(entry[name])}" for name, sign in signs.items() if name in entry]
    return ", ".join(found + ([f"at most {entry['maxLength']} characters"] if "maxLength" in entry else []))


def sweep_page() -> str:
    """Page with the options of [sweep] and the kinds of values, taken from the code."""
    options = "\n".join(
        f"| `{key}` | {_default(one['default'], False)} | {ALLOWED.get(key) or _allowed(one)} | {one['description']} |"
        for key, one in Options.model_json_schema()["properties"].items()
    )
    forms = {name: f"{{{name} = [a, b], number = n}}" for name in (*SPACED, *DRAWN)}
    forms |= {"normal": "{normal = {mean = m, sd = s}, number = n}", "count": "{count = n}"}
    forms |= {"column": '{column = "name", times = f}'}
    values = "\n".join(f"| `{forms[name]}` | {Values.model_fields[name].description} |" for name in KINDS)
    example = (EXAMPLES / "rate_state_sweep.toml").read_text(encoding="utf-8").strip()
    return f"""# Sweeps

Any scenario may contain a `[sweep]` table; `stickslip run` then collects the results of all its runs, the members of
the sweep, in a dataset. The modes, the output files and the use of clusters are described in [many
runs](../many_runs.md).

| key | default | allowed | |
|---|---|---|---|
{options}

All other keys are dotted names of scenario keys in quotes, with entries of lists counted from one
(`"legs.2.velocity"`). At most {MOST:,} members are allowed. A value is a list, or one of

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
