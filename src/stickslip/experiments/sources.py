"""Keys of references.bib for contact laws and rate-and-state friction laws."""

CONTACT = {
    "hertz_mindlin": ("Hertz1882", "Mindlin1949", "Cundall1979"),
    "hertz_mindlin_reff": ("Hertz1882", "Mindlin1953", "Silbert2001"),
    "linear": ("Cundall1979",),
}
CONTACT |= {f"{name}_rescaled": (*CONTACT[name], "LAMMPS") for name in ("hertz_mindlin", "hertz_mindlin_reff")}
STATE = {"aging": ("Dieterich1979", "Ruina1983"), "slip": ("Ruina1983",)}


def law_references(law) -> tuple[str, ...]:
    """Return the references of a built-in law; a law from a file has none, since only its author knows them."""
    return CONTACT[law.kind] if law.file is None else ()
