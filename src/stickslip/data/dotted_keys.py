"""Dotted keys for the tables of a scenario, such as `law.mu`, or `legs.2.velocity` for the second entry of a list."""

from typing import NamedTuple, get_args, get_origin

from pydantic import BaseModel

from .schema import ScenarioError, tables_in, unknown_key


class Entry(NamedTuple):
    """Definition of a key of a scenario."""

    description: str | None
    default: object


def field_at(kind: type[BaseModel], key: str) -> Entry:
    """Description and default of a dotted key, for a class of scenarios.

    Raises
    ------
    ScenarioError
        if there is no such key; the message suggests the closest one.
    """
    parts, tables, above, annotation = key.split("."), [kind], [], None
    for k, part in enumerate(parts):
        if part.isdigit() and above:
            continue
        if get_origin(annotation) is dict and k == len(parts) - 1:  # names that a user chooses
            return Entry(f"{part} of {'.'.join(above)}", None)
        if not tables:
            raise ScenarioError(f"sweep.{key}: {'.'.join(above)} is not a table and has no key {part!r}")
        field = next((table.model_fields[part] for table in tables if part in table.model_fields), None)
        if field is None:
            raise ScenarioError(f"sweep.{key}: {unknown_key((*above, part), kind)}")
        annotation = field.annotation
        above, tables = [*above, part], tables_in(annotation)
        if k == len(parts) - 1 and get_origin(annotation) is dict:
            raise ScenarioError(f"sweep.{key} is a table: name one of its entries, as in {key}.NAME")
        if k == len(parts) - 1 and tables and not get_args(annotation):
            raise ScenarioError(f"sweep.{key} is a table: name one of its keys, {', '.join(tables[0].model_fields)}")
    return Entry(field.description, field.default)


def with_value(tables: dict, key: str, value) -> dict:
    """Return a copy of nested tables with another value at a dotted key.

    Examples
    --------
    >>> with_value({"law": {"mu": 0.3, "kn": 1.0}}, "law.mu", 0.5)
    {'law': {'mu': 0.5, 'kn': 1.0}}
    """
    return _with_value(tables, key.split("."), value, key)


def _with_value(tables, parts: list[str], value, key: str):
    part, below = parts[0], parts[1:]
    if part.isdigit():
        if not isinstance(tables, list | tuple) or not 1 <= int(part) <= len(tables):
            many = len(tables) if isinstance(tables, list | tuple) else "no"
            raise ScenarioError(f"sweep.{key} refers to entry {part}, but the scenario gives {many} entries there")
        here = int(part) - 1
        new = _with_value(tables[here], below, value, key) if below else value
        return [*tables[:here], new, *tables[here + 1 :]]
    if not isinstance(tables, dict):
        raise ScenarioError(f"sweep.{key}: {part!r} is in a list; give the number of the entry, as in legs.2.velocity")
    default = [] if below and below[0].isdigit() else {}
    return tables | {part: _with_value(tables.get(part, default), below, value, key) if below else value}
