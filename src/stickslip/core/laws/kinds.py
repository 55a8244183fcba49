"""Kinds of contact laws, and the registry of user-defined laws in this process."""

from collections.abc import Callable
from typing import NamedTuple

from ...builtin_laws import BUILTIN_LAWS

HELP = "see `stickslip docs contact_laws`"
ROLES = {  # arguments allowed for each function, in addition to parameters of the law
    "normal_force": ("overlap", "r_eff"),
    "normal_energy": ("overlap", "r_eff"),
    "tangential_stiffness": ("overlap", "r_eff"),
    "cap": ("normal_force", "overlap", "r_eff"),
    "contact_range": ("r_eff",),
    "update": ("overlap", "r_eff"),
    "rolling_stiffness": ("overlap", "r_eff"),
    "rolling_cap": ("normal_force", "overlap", "r_eff"),
}


class UserLaw(NamedTuple):
    """Description of a user-defined law."""

    name: str
    names: tuple[str, ...]  # names of all parameters, in the order of the law's table
    source: str  # text, if available
    file: str  # path, if the source is the text of a whole file; else empty
    functions: dict[str, Callable]  # functions by role, as written except for the replacements of `math`, `max` …
    arguments: dict[str, tuple[str, ...]]  # arguments of each function, in order
    memory: dict[str, float]  # values of the additional memory of a contact when it closes
    bonds: bool  # gaps are bridged only after the grains have touched
    size: float  # a grain radius for which the law is validated


USER_LAWS: dict[int, UserLaw] = {}  # laws defined in this process, by kind


class Kind(int):
    """Kind of a user-defined law: a digest of everything that determines its values."""


def check_kind(kind: int) -> None:
    """Raise ValueError if a number is neither that of a built-in law nor the kind of a user-defined one."""
    if not isinstance(kind, Kind) and not 0 <= kind < len(BUILTIN_LAWS):
        raise ValueError(
            f"built-in laws have kinds 0 to {len(BUILTIN_LAWS) - 1}, got {kind}: create a law with a function in "
            "stickslip.laws"
        )


def find_user_law(kind: int) -> UserLaw:
    """Description of a user-defined law.

    Raises
    ------
    ValueError
        If the law was not created in this process.
    """
    if int(kind) not in USER_LAWS:
        raise ValueError(
            f"the law with digest {int(kind):x} is user-defined and unknown in this process: create it with "
            f"laws.custom or laws.from_file first"
        )
    return USER_LAWS[int(kind)]


def describe_law(law) -> dict:
    """Record that identifies a user-defined law, without parameter values. Its text is readable, but never executed."""
    own = find_user_law(law.kind)
    return {"name": own.name, "digest": f"{int(law.kind):x}", "source": own.source, "parameters": " ".join(own.names)}


def restore_kind(kind: int, about: dict) -> Kind:
    """Kind of a user-defined law from its record, if the law was created in this process. Its text is never executed.

    Raises
    ------
    ValueError
        If neither the law nor another law with the same text has been created.
    """
    if kind in USER_LAWS:
        return Kind(kind)
    same = [k for k, own in USER_LAWS.items() if own.source == about.get("source") and "\n" in own.source]
    if same and " ".join(USER_LAWS[same[0]].names) == about.get(
        "parameters"
    ):  # digests differ between versions of Python
        return same[0]
    raise ValueError(
        f"it was computed with {about.get('name', 'a law')!r}, a user-defined contact law (digest {int(kind):x}). "
        "Code in results files is never executed: first create that law with laws.from_file or --law"
    )


def evaluate_role(kind: Kind, role: str, values, **given):
    """Evaluate a function of a law in plain Python; `values` are its parameters in the order of the table."""
    own = find_user_law(kind)
    return own.functions[role](*bound(own, role, dict(zip(own.names, values, strict=True)) | given))


def bound(own: UserLaw, role: str, values: dict) -> list:
    """Arguments of a function from values by name; missing memory has its value at the closing of a contact."""
    values = own.memory | values
    return [values[name] for name in own.arguments[role]]


def update_memory(own: UserLaw, values: dict, **given) -> dict[str, float]:
    """Additional memory of a contact after an update."""
    if not own.memory:
        return {}
    new = own.functions["update"](*bound(own, "update", values | given))
    return dict(zip(own.memory, new if len(own.memory) > 1 else (new,), strict=True))


def own_memory(kind: int) -> dict[str, float]:
    """Names of the additional memory of a law, with its values when a contact closes."""
    return find_user_law(kind).memory if isinstance(kind, Kind) else dict.fromkeys(BUILTIN_LAWS[kind].memory, 0.0)


def bridges_gaps(kind: int) -> bool:
    """Return True if a law acts across gaps."""
    return "contact_range" in find_user_law(kind).functions if isinstance(kind, Kind) else BUILTIN_LAWS[kind].bonds
