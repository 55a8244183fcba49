"""The command that shears a packing until it fails."""

from pathlib import Path
from typing import Annotated

import typer

from ...kit import (
    FigureOptions,
    Output,
    Overwrite,
    PackingFile,
    PackingOptions,
    command,
    complete_from,
    examples,
    in_units_of_packing,
    run_scenario,
)

MODES = {
    "simple": "shear along x with the gradient along y", "pure": "longer along x, shorter along y",
    "isotropic": "compression on all sides", "uniaxial": "compression along y between fixed sides",
}  # fmt: skip
UNTIL = {
    "first-event": "the first discontinuity of the path", "first-pair": "the first complex pair",
    "first-break": "the first bond that breaks",
}  # fmt: skip
SHEAR = examples(
    ("shear examples/sheared_spheres.npz --coulomb sharp --mu 0.3 --settle", "until it jumps to another state"),
    ("shear examples/sheared_spheres.npz --until -2e-4", "shear back, to a strain"),
    (
        "shear examples/sheared_spheres.npz --mode isotropic --until first-event --reverse",
        "decompress until it fails; after ctrl-C, stickslip resume continues",
    ),
)


@command(epilog=SHEAR)
@in_units_of_packing
def shear(
    *,
    file: PackingFile,
    until: Annotated[
        str,
        typer.Option(
            metavar="WHEN",
            help="first-pair, first-event, first-break or a strain; a negative one reverses the shear or unloads.",
            autocompletion=complete_from(UNTIL),
        ),
    ] = "first-event",
    mode: Annotated[str, "simple, pure, isotropic or uniaxial.", MODES] = "simple",
    reverse: Annotated[bool, "Let the strain fall, with --until first-…: shear back or unload."] = False,
    step: Annotated[float | None, "Largest strain step; default: 0.02 × overlap/diameter."] = None,
    limit: Annotated[float | None, "Strain at which the path ends in any case; default: 500 steps."] = None,
    drag: Annotated[
        float | None, "Drag that determines events [1/time]; default: 0.1 of the highest frequency."
    ] = None,
    settle: Annotated[bool, "First bring the packing to rest under this law."] = False,
    out: Annotated[Path | None, "Folder for results; default: results/shear-FILE."] = None,
    overwrite: Overwrite = False,
    drawing: FigureOptions,
    output: Output,
    options: PackingOptions,
) -> None:
    """Shear or compress a packing quasi-statically until it fails, and forecast its next event.

    Writes the stress-strain curve, births and deaths of complex pairs, events, contacts that open, close or slide,
    bonds that break, forecasts with intervals, a figure and a page. The packing must be in equilibrium in a periodic
    cell without walls. After ctrl-C or a kill, stickslip resume continues.
    """
    from ...kit import trust_law_files, validate_scenario
    from .failure.scenario import FailureScenario
    from .failure.simulate import digest_of, keep_packing, read_input

    named = file if file.name.strip(".") else file.resolve()
    folder, look = out or Path("results") / f"shear-{named.stem}", drawing.look()
    chosen = validate_scenario(
        FailureScenario, **_tables(file, options, settle),
        shear={
            "until": until if until in UNTIL else _strain(until), "mode": mode, "reverse": reverse, "step": step,
            "limit": limit, "drag": drag,
        },
    )  # fmt: skip
    trust_law_files(chosen.model_dump())  # the user typed the name of the file
    packed = read_input(chosen)
    chosen = chosen.model_copy(update={"packing": chosen.packing.model_copy(update={"digest": digest_of(packed)})})
    run_scenario(
        "shear", chosen, folder, output, look, overwrite=overwrite, begin=lambda: keep_packing(folder, chosen, packed)
    )


def _strain(word: str) -> float:
    from ...kit import parse_number

    try:
        return parse_number(word)
    except ValueError:
        allowed = "first-pair, first-event, first-break or a strain such as 1e-3"
        raise ValueError(f"--until must be {allowed}, got {word!r}") from None


def _tables(file: Path, options: PackingOptions, settle: bool) -> dict:
    """Scenario tables from the options shared by all commands that read a packing."""
    from ...kit import current_units

    given = {name: value for name, value in options.values().items() if value is not None}
    more, kind = given.pop("parameters", {}), given.pop("law", None)
    names = ("frame", "contacts", "columns", "boundary", "atom_style", "i0")
    place = {name: given.pop(name) for name in names if name in given}
    if "contacts" in place:
        place["contacts"] = str(Path(place["contacts"]).absolute())
    if str(kind).endswith(".py"):
        numbers = {name: given.pop(name) for name in list(given) if isinstance(given[name], float)}
        law = {"file": str(Path(kind).absolute()), "parameters": numbers | more}
    else:
        law = {"more": more} | ({} if kind is None else {"kind": kind})
    units = current_units()
    named = {} if units is None else {"units": dict(zip(("length", "mass", "time"), units, strict=False))}
    return named | {"packing": place | {"file": str(file.absolute()), "settle": settle}, "law": law | given}
