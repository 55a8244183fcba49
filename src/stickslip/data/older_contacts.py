"""Contact lists from files of this version and of older ones."""

import numpy as np

from ..core.state import Contacts


def restore_contacts(fields: dict) -> Contacts:
    """Contact list from its fields in a file.

    Up to schema 4 of archives, and schema 1 of GSD files, the skin was an array, the gap its second entry, infinite
    positions meant a stale list, and a law without rolling memory had an array without rows.
    """
    fields = {name: v.item() if isinstance(v, np.ndarray) and not v.ndim else v for name, v in fields.items()}
    if "stale" not in fields:
        skin, known = np.atleast_1d(fields["skin"]), np.isfinite(fields["origin"])
        fields |= {"skin": float(skin[0]), "gap": float(skin[1:].sum()), "stale": not known.all()}
        fields["origin"] = np.where(known, fields["origin"], 0.0)
        if not len(fields.get("rolling", ())):
            fields["rolling"] = None
    return Contacts(**fields)
