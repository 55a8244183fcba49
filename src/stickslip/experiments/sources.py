"""Keys of references.bib for contact laws and laws of rate-and-state friction."""

CONTACT = {
    "hertz_mindlin": ("Hertz1882", "Mindlin1949", "Cundall1979"),
    "hertz_mindlin_reff": ("Hertz1882", "Mindlin1953", "Silbert2001"),
    "linear": ("Cundall1979",),
}
CONTACT |= {f"{name}_rescaled": (*CONTACT[name], "LAMMPS") for name in ("hertz_mindlin", "hertz_mindlin_reff")}
STATE = {"aging": ("Dieterich1979", "Ruina1983"), "slip": ("Ruina1983",)}


def of_law(law) -> tuple[str, ...]:
    """Sources of a built-in law; those of a law in a file are its author's to name."""
    return CONTACT[law.kind] if law.file is None else ()
