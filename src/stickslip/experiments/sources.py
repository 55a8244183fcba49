"""Keys of references.bib for contact laws and rate-and-state friction laws."""

from ..builtin_laws import BUILTIN_LAWS

CONTACT = {law.name: law.sources for law in BUILTIN_LAWS}
STATE = {"aging": ("Dieterich1979", "Ruina1983"), "slip": ("Ruina1983",)}


def law_references(law) -> tuple[str, ...]:
    """Return the references of a built-in law; a law from a file has none, since only its author knows them."""
    return CONTACT[law.kind] if law.file is None else ()
