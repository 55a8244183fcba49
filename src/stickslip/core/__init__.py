"""Compiled kernels and the values that they work on: numpy, numba and math only.

Numba's disk cache does not notice that an imported law has changed. Before any kernel is decorated, the cache is
therefore pointed to a folder named by a hash of these sources, unless the user chose one with NUMBA_CACHE_DIR.
"""

import hashlib
import os
import tempfile
from pathlib import Path

import numba


def _kernel_cache() -> str:
    sources = b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py")))
    name = hashlib.sha256(sources + numba.__version__.encode()).hexdigest()[:16]
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    folder = base / "stickslip" / name
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            return str(folder)
    except OSError:
        pass
    return tempfile.mkdtemp(prefix="stickslip-kernels-")


if not os.environ.get("NUMBA_CACHE_DIR"):
    numba.config.CACHE_DIR = _kernel_cache()
