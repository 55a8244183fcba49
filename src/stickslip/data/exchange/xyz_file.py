"""Extended XYZ files, which ASE and OVITO read: grains as atoms of species X, further columns, the cell, and the law.

They are written without a library, because ASE would write only eight decimals.
"""

import json
from pathlib import Path

from ..atomic import replace_atomically
from .frame import Frame, law_to_dict, list_losses


def write_xyz(path: str | Path, frames: list[Frame]) -> list[str]:
    """Write frames one after the other, with numbers exact to the last bit.

    Return notes on what the format does not store.
    """
    with replace_atomically(Path(path)) as part, part.open("w", encoding="utf-8") as file:
        for frame in frames:
            file.write(_format_frame(frame))
    lost = ["contacts and their memory", *list_losses(frames[0], law=False)]
    return [f"extended XYZ does not store {', '.join(lost)}"]


def _format_frame(frame: Frame) -> str:
    grains, cell = frame.state.grains, frame.state.cell
    named = {"pos": grains.position, "radius": grains.radius, "mass": grains.mass, "velo": grains.velocity}
    named |= {"spin": grains.spin, "angle": grains.angle, "inertia": grains.inertia, "material": grains.material}
    named |= {"contact_force" if name == "force" else name: column for name, column in frame.grains.items()}
    columns, kinds = [], []
    for name, values in named.items():
        width = 1 if values.ndim == 1 else values.shape[1]
        kinds.append(f"{name}:{'I' if values.dtype.kind in 'iu' else 'R'}:{width}")
        columns.append([" ".join(map(repr, row)) for row in values.reshape(-1, width).tolist()])
    lattice = " ".join(repr(v) for v in cell.vectors.ravel().tolist())
    flags = " ".join("T" if p else "F" for p in cell.periodic)
    law = json.dumps(json.dumps(law_to_dict(frame.law)))  # quoted, with inner quotes escaped
    head = [f'Lattice="{lattice}"'] if cell.periodic.any() else []
    head += [f'pbc="{flags}"', f"Properties=species:S:1:{':'.join(kinds)}"]
    head += [f"time={frame.state.time!r}", f"dim={cell.dim}", f"law={law}"]
    rows = (f"X {' '.join(row)}\n" for row in zip(*columns, strict=True))
    return f"{len(grains.radius)}\n{' '.join(head)}\n{''.join(rows)}"
