"""Watching a simulation with its table, its page and the terminal."""

import time
from pathlib import Path

from ....data.exchange.lammps_series import Source
from ....kit import check_free, check_output
from .loop import Progress, watch
from .page import write_page
from .screen import screen
from .table import describe, read_rows, write_rows

SAVE_EVERY = 3.0  # least time between two writes of table and page [s]
REST = 5.0  # the same, over the time that a write takes


def watch_and_record(
    source: Source, table: Path, *, method: str, once: bool, until_idle: float | None, overwrite: bool, made_from=()
) -> tuple[Progress, str]:
    """Watch until the end; return what is known then, and, after ctrl-C, a sentence that names the table.

    Raises
    ------
    ValueError
        before anything is computed, if the table or the page would replace something else.
    """
    page, how = table.with_suffix(".html"), describe(source, method)
    if table.suffix.lower() != ".csv":
        raise ValueError(f"--out {table} ends with {table.suffix or 'nothing'!r}: use .csv")
    check_output(page, (".html",), overwrite=overwrite, made_from=made_from)
    check_free([table], overwrite=True, made_from=made_from)
    known, due = read_rows(table, how, overwrite=overwrite), float("-inf")
    done = Progress(known, (), 0)

    def save(done: Progress) -> None:
        write_rows(table, done.rows, how)
        write_page(page, source.folder, table, done, how)

    try:
        with screen() as shown:
            for done in watch(source, known, method=method, once=once, until_idle=until_idle, report=shown.report):
                shown.show(done)
                if not done.live or (done.any_computed and time.monotonic() >= due):
                    start = time.monotonic()
                    save(done)
                    now = time.monotonic()
                    due = now + max(SAVE_EVERY, REST * (now - start))
    except KeyboardInterrupt:
        if not done.any_computed:
            return done, "stopped by the user before a frame was computed: there is no table"
        save(done._replace(live=False))
        left = f"; {done.left} frames are not computed yet" if done.left else ""
        return done, f"stopped by the user: {table} has {len(done.rows)} frames{left}, and the same command continues"
    return done, ""
