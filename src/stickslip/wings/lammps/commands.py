"""The command that watches a running LAMMPS simulation."""

from pathlib import Path
from typing import Annotated

import typer

from ...kit import Output, PackingOptions, StoppedError, check_choice, command, examples, finish, in_units_of_packing

METHODS = {
    "auto": "the fastest growth; for many grains only in equilibrium", "none": "no spectrum", "fastest": "always",
    "all": "all complex pairs", "dense": "all eigenvalues", "pairs": "all complex pairs",
}  # fmt: skip
LAW = r"""--law hertz_mindlin_reff \
      --kn 1 --kt 0.8 --mu 0.2 --damping-n 0 --damping-t 0"""
WATCH = examples(
    (f"watch examples/sheared {LAW} --once", "a finished series; writes watch.csv and watch.html next to it"),
    (f"watch examples/sheared {LAW} --until-idle 1", "ends when LAMMPS has not written for a second"),
)
NAME = "watch.csv"


@command(epilog=WATCH)
@in_units_of_packing
def watch(
    *,
    place: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of the dumps, or one dump of grains in it.")],
    once: Annotated[bool, "Compute the frames present, and end."] = False,
    until_idle: Annotated[
        float | None, typer.Option(min=0, metavar="SECONDS", help="End when nothing has been written for this time.")
    ] = None,
    out: Annotated[Path | None, "Table; the page is next to it, with .html. Default: watch.csv in DIR."] = None,
    method: Annotated[str, "auto, none, fastest, all, dense or pairs.", METHODS] = "auto",
    no_contacts: Annotated[bool, "Ignore dumps of contacts, as if none had slipped."] = False,
    overwrite: Annotated[bool, "Replace the table and the page."] = False,
    output: Output,
    options: PackingOptions,
) -> None:
    """Follow the dumps of a running LAMMPS simulation: stress, contacts, softest mode and fastest pair of each frame.

    Each complete frame becomes a row of a table, in the terminal and as CSV; a page that reloads itself shows charts.
    Frames in the table are not computed again. Without --once or --until-idle, ctrl-C ends the watch. --contacts may
    be a pattern of names in DIR; by default, all dumps of contacts there are used. `stickslip docs lammps` describes
    the required output of LAMMPS.
    """
    check_choice("method", method, METHODS)
    if once and until_idle is not None:
        raise ValueError("--once and --until-idle exclude each other: give one")
    from ...kit import lammps_series, terminal
    from .watch_record import watch_and_record

    source = lammps_series.open_source(place, memory=not no_contacts, **options.values())
    table = out or source.folder / NAME
    with terminal.console_output(*output):
        done, stopped = watch_and_record(
            source, table, method=method, once=once, until_idle=until_idle, overwrite=overwrite,
            made_from=(options.law,),
        )  # fmt: skip
    if stopped:
        raise StoppedError(stopped)
    paths = [table, table.with_suffix(".html")]

    def answer() -> dict:
        from ...kit import json_output

        last = done.rows[max(done.rows)]
        more = {"frames": len(done.rows), "newest": last._asdict(), "notes": done.notes}
        return json_output.common_fields("watch", files=paths, folder=source.folder) | more

    finish(answer, paths, lambda: None, output)
